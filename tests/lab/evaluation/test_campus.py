"""A campus of maps: which are twins, what becomes of queries, and what is counted."""

from functools import partial
from pathlib import Path

import pytest
import torch

from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.retrieval_vectors import RetrievalVectors
from panoloc.core.options import IndexOptions
from panoloc.lab.evaluation.campus import (
    Campus,
    CampusRow,
    campus_queries,
    campus_rows,
    campus_summary,
    read_vectors,
)


def test_the_last_tenth_of_a_campus_are_twins_of_the_first(tmp_path: Path) -> None:
    campus = Campus(tmp_path, 20)
    assert [campus.twin_of(number) for number in (0, 1, 2, 17)] == [18, 19, None, None]
    assert (campus.seed_of(18), campus.kind_of(18)) == (campus.seed_of(0), campus.kind_of(0))
    assert len({campus.seed_of(number) for number in range(18)}) == 18
    assert [campus.kind_of(number) for number in range(6)] == ["room"] * 4 + ["flat", "room"]
    # Maps of places are shared by campuses of all sizes, and no twin takes the place of one.
    assert campus.path(3) == Campus(tmp_path, 40).path(3)
    assert len({campus.path(number) for number in range(20)} | {Campus(tmp_path, 40).path(18)}) == 21


def test_wrong_answers_and_those_that_are_too_sure_of_a_twin_are_counted(tmp_path: Path) -> None:
    none = RetrievalVectors(
        torch.empty((3, 1024), dtype=torch.int8),
        torch.empty(3),
        torch.empty((288, 3, 3), dtype=torch.int8),
        torch.eye(3),
    )
    rows = [
        CampusRow(5, "localized", 0.99, 0.5, 0, in_right_map=True, is_right=True),
        CampusRow(6, "localized", 0.9, 0.7, None, in_right_map=False, is_right=False),
        CampusRow(7, "not_localized", 0.2, 0.9, 3, in_right_map=True, is_right=False),
        CampusRow(0, "ambiguous", 0.5, 0.5, 1, in_right_map=True, is_right=True),
        CampusRow(1, "localized", 0.99, 0.5, 1, in_right_map=True, is_right=True),
    ]
    found = campus_summary(Campus(tmp_path, 20), [none] * 20, rows)
    assert (found["maps"], found["starts"], found["queries"]) == (20, 60, 5)
    assert (found["right_map_first"], found["right"], found["recall"]) == (0.8, 0.6, 0.8)
    assert (found["localized"], found["ambiguous"]) == (0.6, 0.2)
    assert (found["wrong"], found["twin_sure"]) == (1, 1)
    assert found["p50_s"] == 0.5


@pytest.mark.slow
def test_a_panorama_of_a_changed_room_is_found_among_rooms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A thirtieth of the starts.
    coarse = partial(build_map_index, options=IndexOptions(spacing_m=1.5))
    monkeypatch.setattr("panoloc.lab.evaluation.campus.build_map_index", coarse)
    campus = Campus(tmp_path, 2)
    for number in range(campus.num_maps):
        campus.build(number)
    vectors = read_vectors(campus)
    (row,) = campus_rows(campus, vectors, list(campus_queries(campus, 1, None)), Localizer(device="cpu"))
    assert (row.status, row.is_right, row.rank) == ("localized", True, 0)
