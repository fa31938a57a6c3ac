"""Suites and case folders as sources."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.lab.evaluation.known_cases import KnownQuery, SourceError, limited
from panoloc.lab.evaluation.sources import folder_scans, seed_range, suite_scans


def test_seeds_are_numbers_and_ranges_and_nothing_else() -> None:
    assert [seed_range(text) for text in ("7", "1000-1002", "1,3, 5-6")] == [[7], [1000, 1001, 1002], [1, 3, 5, 6]]
    for text in ("", "a", "5-3", "1-", "-4", "1;2"):
        with pytest.raises(OptionsError, match="seeds"):
            seed_range(text)


def test_a_suite_has_a_scan_per_seed_and_makes_none_before_it_is_loaded() -> None:
    scans = suite_scans("changed", range(1000, 3000))
    assert len(scans) == 2000
    assert scans[0].name == "changed-1000"
    assert scans[0].place == suite_scans("rooms", [1000])[0].place  # the same room: no stranger


def test_names_differ_where_the_cases_do() -> None:
    changes: list[dict[str, Any]] = [{}, {"families": ["nordic"]}, {"width": 512}, {"num_points": 5000}]
    assert len({suite_scans("rooms", [1], **change)[0].name for change in changes}) == len(changes)


@pytest.mark.slow
def test_a_loaded_suite_case_knows_its_pose_and_what_changed() -> None:
    scan = suite_scans("changed", [3], width=128, num_points=5000)[0]
    loaded = scan.load()
    assert 2500 < len(loaded.cloud) <= 5000
    query = loaded.query(scan.query_names[0])
    assert query.panorama.valid.shape == (64, 128)
    assert query.changed_pixels is not None
    assert query.changed_points is not None
    assert query.changed_pixels.shape == (64, 128)
    assert len(query.changed_points) == len(loaded.cloud)
    assert query.error_of(query.poses[0]).within(0, 1e-3)


def test_case_folders_give_their_poses_back(box_folder: Path) -> None:
    scans = folder_scans(box_folder)
    assert [(scan.name, scan.query_names) for scan in scans] == [
        ("first", ("q0.jpg", "q1.jpg")),
        ("second", ("q0.jpg",)),
    ]
    assert [scan.query_names for scan in folder_scans(box_folder, tags=("q1",))] == [("q1.jpg",), ()]
    truth = json.loads((box_folder / "first" / "truth.json").read_text())
    query = scans[0].load().query("q1.jpg")
    assert query.poses[0].position.tolist() == truth["queries"][1]["position_m"]
    assert np.allclose(query.poses[0].rotation, truth["queries"][1]["rotation"])


def test_a_limit_counts_the_queries_of_each_group(box_folder: Path) -> None:
    scans = folder_scans(box_folder)
    assert [scan.query_names for scan in limited(scans, 1)] == [("q0.jpg",), ("q0.jpg",)]
    one_group = [replace(scan, group="both") for scan in scans]
    assert [scan.query_names for scan in limited(one_group, 1)] == [("q0.jpg",)]
    assert [len(scan.query_names) for scan in limited(one_group, 3)] == [2, 1]
    assert limited(scans, None) == scans


def test_a_folder_without_truth_and_a_broken_truth_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="found none"):
        folder_scans(tmp_path)
    (tmp_path / "truth.json").write_text('{"scans": ["scan.ply"]}')
    with pytest.raises(SourceError, match="queries"):
        folder_scans(tmp_path)


ENTRY = {"image": "q.jpg", "position_m": [0, 0, 1], "rotation": np.eye(3).tolist()}


@pytest.mark.parametrize(
    ("queries", "said"),
    [
        ([ENTRY | {"scan": "b.ply"}], r"queries\[0\]\.scan: expected one of a.ply, got 'b.ply'"),
        ([ENTRY, ENTRY], "each image once for a.ply"),
        ([ENTRY, ENTRY | {"image": "z.jpg"}], "did not find z.jpg"),
        (
            [ENTRY, ENTRY | {"image": "r.jpg", "rotation": (2 * np.eye(3)).tolist()}],
            r"queries\[1\]: expected an orthonormal",
        ),
        ([ENTRY | {"rotation": np.diag([1, -1, 1]).tolist()}], "right-handed"),
        ([ENTRY | {"rotation": [0, 0, 0, 1]}], "3 x 3 numbers"),
        ([ENTRY | {"position_m": {"x": 1}}], "position_m and rotation"),
        ([{"image": "q.jpg"}], "position_m and rotation"),
        (["q.jpg"], "position_m and rotation"),
    ],
)
def test_a_query_that_is_not_as_expected_is_named_and_none_is_dropped(
    queries: list[object], said: str, tmp_path: Path
) -> None:
    for name in ("a.ply", "q.jpg", "r.jpg"):
        (tmp_path / name).touch()
    (tmp_path / "truth.json").write_text(json.dumps({"scans": ["a.ply"], "queries": queries}))
    with pytest.raises(SourceError, match=said):
        folder_scans(tmp_path)


def test_one_image_may_be_known_in_several_scans(tmp_path: Path) -> None:
    for name in ("a.ply", "b.ply", "q.jpg"):
        (tmp_path / name).touch()
    queries = [ENTRY | {"scan": scan, "tags": [scan]} for scan in ("a.ply", "b.ply")]
    (tmp_path / "truth.json").write_text(json.dumps({"scans": ["a.ply", "b.ply"], "queries": queries}))
    assert [scan.query_names for scan in folder_scans(tmp_path)] == [("q.jpg",), ("q.jpg",)]
    assert [scan.query_names for scan in folder_scans(tmp_path, tags=("b.ply",))] == [(), ("q.jpg",)]
    with pytest.raises(SourceError, match="queries with the tags day, night, found none"):
        folder_scans(tmp_path, tags=("day", "night"))


def test_a_query_tells_its_own_room_from_the_others() -> None:
    own, twin, alike = (Pose(np.eye(3), np.array([x, 0.0, 1.5])) for x in (0.0, 5.0, 10.0))
    nothing = Rig.of_panorama(Panorama(np.zeros((2, 4, 3), np.uint8), np.ones((2, 4), bool)))
    query = KnownQuery(nothing, (own, twin), aliases=(alike,))
    found = [Pose(np.eye(3), np.array([x, 0.1, 1.5])) for x in (0.0, 5.0, 10.0, 7.0)]
    assert [query.place_of(pose) for pose in found] == ["own", "other", "other", "elsewhere"]
    assert query.error_of(found[1]).position_m == pytest.approx(0.1)
    assert replace(query, poses=(own,), aliases=()).place_of(own) is None
