"""Runs: rows beside the truth, strangers, continuation."""

from pathlib import Path
from typing import Any

import pytest

from panoloc.core.decide.confidence import load_confidence_model
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.evaluation.fit_confidence import features_of_row
from panoloc.lab.evaluation.known_cases import ScanCases, limited
from panoloc.lab.evaluation.methods import compared_method
from panoloc.lab.evaluation.photo_source import as_photos
from panoloc.lab.evaluation.rows import Row, RowsFile
from panoloc.lab.evaluation.runner import Evaluation, RunOptions
from panoloc.lab.evaluation.sources import folder_scans

FAST = compared_method("fast=fast:search.rotations=2304,search.num_candidates=8,refinement.fine_rows=64")


def _evaluation(root: Path, file: Path, num_strangers: int = 0, **options: float) -> Evaluation:
    return Evaluation(
        folder_scans(root),
        [FAST],
        RowsFile(file),
        RunOptions("cpu", num_strangers, **options),  # type: ignore[arg-type]
    )


@pytest.fixture(scope="module")
def finished(box_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Row]]:
    """Return the file and the rows of a whole run with one stranger for each panorama."""
    file = tmp_path_factory.mktemp("run") / "rows.jsonl"
    return file, [row for row, _ in _evaluation(box_folder, file, 1).rows()]


@pytest.mark.slow
def test_every_panorama_is_sent_to_its_own_map_and_to_a_stranger(finished: tuple[Path, list[Row]]) -> None:
    calls = [(row.query, row.scan, row.cross) for row in finished[1]]
    assert calls == [
        ("first/q0.jpg", "first", False),
        ("first/q1.jpg", "first", False),
        ("first/q0.jpg", "second", True),
        ("first/q1.jpg", "second", True),
        ("second/q0.jpg", "second", False),
        ("second/q0.jpg", "first", True),
    ]
    assert all(row.position_error_m is None and not row.within((100, 180)) for row in finished[1] if row.cross)


@pytest.mark.slow
def test_poses_in_the_own_map_are_right_and_have_what_the_fit_needs(finished: tuple[Path, list[Row]]) -> None:
    model = load_confidence_model()
    for row in (row for row in finished[1] if not row.cross):
        assert row.within((0.1, 5.0)), row
        features = dict(zip(model.coefficients, features_of_row(row), strict=True))
        assert row.confidence == pytest.approx(model.probability(features), abs=1e-6)
        assert row.formal_position_m is not None
        measures = row.search["measures"]
        names = "halves_apart_m", "coverage", "thickness_m"
        radius = model.position_radius.radius(row.formal_position_m, *(measures[name] for name in names))
        assert row.accuracy_position_m == pytest.approx(radius)


@pytest.mark.slow
def test_an_interrupted_run_goes_on_where_it_stopped(
    box_folder: Path, finished: tuple[Path, list[Row]], tmp_path: Path
) -> None:
    file = tmp_path / "rows.jsonl"
    lines = finished[0].read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:-2]) + lines[-2][:50])
    again = list(_evaluation(box_folder, file, 1).rows())
    assert [is_new for _, is_new in again] == [False] * 4 + [True] * 2
    repeated = [(row.query, row.scan, row.status) for row, _ in again]
    assert repeated == [(row.query, row.scan, row.status) for row in finished[1]]


@pytest.mark.slow
def test_calls_that_fail_are_rows_that_say_why_and_the_same_points_have_one_map(
    box_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[int] = []

    def build(cloud: PointCloud, *options: Any, **more: Any) -> MapIndex:
        built.append(len(cloud))
        return build_map_index(cloud, *options, **more)

    monkeypatch.setattr("panoloc.lab.evaluation.runner.build_map_index", build)
    file = RowsFile(tmp_path / "rows.jsonl")
    # A row of another configuration does not count.
    file.append(Row("first", "first", "first/q0.jpg", FAST.name, "another", False, "localized", 1.0))
    scans = limited(folder_scans(box_folder), 1)[:1]
    scans += as_photos(scans, "photo", [1], 64)
    run = Evaluation(scans, [FAST], file, RunOptions("cpu", timeout_s=1e-9))
    rows = [row for row, is_new in run.rows() if is_new]
    assert [(row.status, str(row.error).partition(":")[0]) for row in rows] == [("error", "DeadlineExceededError")] * 2
    assert len(built) == 1


def test_scans_of_one_place_are_run_together(tmp_path: Path) -> None:
    def scan(name: str, place: str) -> ScanCases:
        return ScanCases(name, "g", ("q",), lambda: pytest.fail("every answer is known"), place)

    file = RowsFile(tmp_path / "rows.jsonl")
    scans = [scan("a1", "1"), scan("a2", "2"), scan("b1", "1"), scan("b2", "2")]
    for one in scans:
        file.append(Row("g", one.name, f"{one.name}/q", FAST.name, FAST.digest, False, "not_localized", 1.0))
    run = Evaluation(scans, [FAST], file, RunOptions("cpu"))
    assert [row.scan for row, _ in run.rows()] == ["a1", "b1", "a2", "b2"]
