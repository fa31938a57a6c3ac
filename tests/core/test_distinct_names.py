"""Each name once, and those of others left alone."""

from panoloc.core.distinct_names import distinct_names


def test_what_is_taken_gets_a_number_before_its_ending_that_nobody_else_has() -> None:
    assert distinct_names(["a.jpg", "a.jpg", "a-2.jpg", "b/a.jpg"]) == ["a.jpg", "a-3.jpg", "a-2.jpg", "b/a.jpg"]


def test_upper_and_lower_case_are_one_as_on_the_disks_of_many_systems() -> None:
    assert distinct_names(["Hall.JPG", "hall.jpg", "HALL.jpg"]) == ["Hall.JPG", "hall-2.jpg", "HALL-3.jpg"]
