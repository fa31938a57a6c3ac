"""Looks at the console of a running service as people do: screenshots for the documentation, and how it copes with a large scan."""
