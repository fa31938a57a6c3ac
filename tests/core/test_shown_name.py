"""Names of files in lists for people."""

import pytest

from panoloc.core.shown_name import shown_name


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
    assert shown_name(name) == shown
