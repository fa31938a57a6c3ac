"""Names of files: shown to people, and each once."""

import pytest

from panoloc.core.scan.file_names import display_name, distinct_names


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("rooms/büro 1.jpg", "rooms/büro 1.jpg"),
        ("\x1b[31mred.jpg", r"\x1b[31mred.jpg"),
        ("two\nlines\u202e.jpg", r"two\nlines\u202e.jpg"),
        ("no \udcff utf-8.jpg", "no \udcff utf-8.jpg"),
    ],
)
def test_what_steers_a_terminal_is_written_out(name: str, shown: str) -> None:
    assert display_name(name) == shown


def test_what_is_taken_gets_a_number_before_its_ending_that_nobody_else_has() -> None:
    assert distinct_names(["a.jpg", "a.jpg", "a-2.jpg", "b/a.jpg"]) == ["a.jpg", "a-3.jpg", "a-2.jpg", "b/a.jpg"]
    # Upper and lower case are one on the disks of many systems.
    assert distinct_names(["Hall.JPG", "hall.jpg", "HALL.jpg"]) == ["Hall.JPG", "hall-2.jpg", "HALL-3.jpg"]
