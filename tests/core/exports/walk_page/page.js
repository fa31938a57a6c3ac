// The page of the tests.
