"""Rows survive interruptions, and files that are not rows are refused."""

from pathlib import Path

import pytest

from panoloc.lab.evaluation.rows import RowsError, RowsFile, read_rows
from tests.lab.evaluation.made_rows import made_row


def test_what_was_appended_is_read_back(tmp_path: Path) -> None:
    file = RowsFile(tmp_path / "deep" / "rows.jsonl")
    rows = [made_row(0, search={"score": 1.5}), made_row(1, None, error="DeadlineExceededError: späť")]
    for row in rows:
        file.append(row)
    assert file.rows() == rows


def test_a_row_cut_off_by_an_interruption_is_left_out_and_the_next_one_is_whole(tmp_path: Path) -> None:
    file = RowsFile(tmp_path / "rows.jsonl")
    file.append(made_row(0))
    file.append(made_row(1))
    file.path.write_bytes(file.path.read_bytes()[:-40])
    assert file.rows() == [made_row(0)]
    # Of two rows of the same call the later one counts.
    for seconds in (1.0, 2.0):
        file.append(made_row(2, seconds=seconds))
    assert file.rows() == [made_row(0), made_row(2, seconds=2.0)]


def test_unknown_fields_of_later_versions_are_ignored(tmp_path: Path) -> None:
    file = RowsFile(tmp_path / "rows.jsonl")
    file.append(made_row(0))
    file.path.write_text(file.path.read_text().replace('{"group"', '{"invented": 1, "group"'))
    assert file.rows() == [made_row(0)]


def test_a_file_of_something_else_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text('{"a": 1}\n')
    with pytest.raises(RowsError, match="line 1"):
        read_rows([path])


@pytest.mark.parametrize(
    ("status", "place", "wrong"),
    [("localized", "other", True), ("localized", "own", False), ("ambiguous", "other", False)],
)
def test_an_equal_room_that_is_surely_not_the_one_is_a_wrong_answer(status: str, place: str, wrong: bool) -> None:
    assert made_row(status=status, facts={"place": place}).is_wrong_answer == wrong
