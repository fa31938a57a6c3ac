"""Suites give complete cases, and cases survive the way to disk."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from panoloc.core.errors import OptionsError
from panoloc.lab.rooms import (
    Case,
    PosedPanorama,
    make_case,
    suite_cases,
    write_case_folder,
)
from panoloc.lab.rooms.materials.labels import LABEL_COLORS
from panoloc.lab.rooms.suites import SUITES

SHARED_CASES = Path(__file__).parents[4] / "shared" / "cases"


def made(name: str, seed: int, num_points: int = 2000, width: int = 64, **changes: Any) -> Case:
    """Return a small case of a suite with some of its recipe changed."""
    return make_case(name, replace(SUITES[name], num_points=num_points, **changes), seed, width=width)


@pytest.fixture(scope="module")
def case() -> Case:
    return made("changed", 3, 5000, 256)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "changed" else pytest.mark.slow) for name in SUITES]
)
def test_every_suite_gives_complete_cases(name: str) -> None:
    case = made(name, 1, 4000, 128)
    assert len(case.cloud) == 4000
    assert case.panorama.color.shape == (64, 128, 3)
    assert case.changed_pixels is not None
    assert case.changed_pixels.shape == (64, 128)
    assert case.changed_points.shape == (4000,)
    assert np.isfinite(case.cloud.positions).all()
    low, high = case.cloud.bounds
    position = case.pose.position - case.cloud.origin_offset
    assert (low <= position).all()
    assert (position <= high).all()
    assert bool(case.changed_points.any()) == (SUITES[name].change > 0)
    rows = case.panorama.valid.all(axis=1)
    assert (rows == (np.abs(np.arange(64) - 31.5) < (16 if name == "partial" else 32))).all()
    if case.region is not None:
        assert (np.array(case.region[0]) <= case.pose.position).all()
        assert (case.pose.position <= np.array(case.region[1])).all()
    if case.color_kind == "labels":
        shown = set(map(tuple, np.unique(case.panorama.color.reshape(-1, 3), axis=0).tolist()))
        assert shown <= set(LABEL_COLORS.values())
    else:
        assert case.panorama.color.std() > 8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "alternatives", "aliases"),
    # Rooms that changed since the scan are no longer as right as each other.
    [("repeated", 0.0, 2, 0), ("mirrored", 0.0, 0, 1), ("twins_like", 0.0, 0, 1), ("twins", 0.6, 0, 1)],
)
def test_cases_know_what_is_as_right_and_what_only_looks_so(
    name: str, change: float, alternatives: int, aliases: int
) -> None:
    case = made(name, 1, change=change)
    assert (len(case.alternatives), len(case.aliases)) == (alternatives, aliases)


def test_an_unknown_suite_or_family_is_refused_at_once() -> None:
    with pytest.raises(OptionsError, match="changed"):
        suite_cases("underwater", [0])
    with pytest.raises(OptionsError, match="nordic"):
        suite_cases("rooms", [0], families=["baroque"])


@pytest.mark.slow
def test_cases_are_made_one_by_one_of_the_families_that_are_asked_for() -> None:
    office, classic = (
        next(suite_cases("rooms", range(10**9), families=[family], width=64, num_points=2000))
        for family in ("office", "classic")
    )
    assert office.seed == classic.seed == 0
    assert office.cloud.colors.mean() != classic.cloud.colors.mean()


def written(case: Case, folder: Path) -> dict[str, Any]:
    """Write a case to a folder and return its truth."""
    query = PosedPanorama(case.name, case.panorama, case.pose, ("made",))
    path = write_case_folder(folder, case.name, case.cloud, [query], color_kind=case.color_kind)
    return dict(json.loads(path.read_text()))


def test_a_case_folder_holds_scan_panorama_and_truth(case: Case, tmp_path: Path) -> None:
    import open3d

    truth = written(case, tmp_path)
    (query,) = truth["queries"]
    np.testing.assert_allclose(query["position_m"], case.pose.position)
    np.testing.assert_allclose(query["rotation"], case.pose.rotation)
    image = np.asarray(Image.open(tmp_path / query["image"]), float)
    assert image.shape == (128, 256, 3)
    assert np.abs(image - case.panorama.color).mean() < 4
    cloud = open3d.t.io.read_point_cloud(tmp_path / truth["scans"][0])
    np.testing.assert_array_equal(cloud.point.positions.numpy(), case.cloud.positions)
    np.testing.assert_array_equal(cloud.point.colors.numpy(), case.cloud.colors)


@pytest.mark.slow
def test_survey_coordinates_keep_their_millimetres_on_disk(tmp_path: Path) -> None:
    import open3d

    case = made("survey", 2)
    assert case.cloud.origin_offset[1] > 1e6
    truth = written(case, tmp_path)
    cloud = open3d.t.io.read_point_cloud(tmp_path / truth["scans"][0])
    read = cloud.point.positions.numpy() - case.cloud.origin_offset
    np.testing.assert_allclose(read, case.cloud.positions, atol=1e-6)
    assert np.abs(read - (np.array(truth["queries"][0]["position_m"]) - case.cloud.origin_offset)).max() < 15


@pytest.mark.slow
def test_turning_the_frame_turns_cloud_and_pose_alike() -> None:
    plain, turned = (made("rooms", 2, 500, survey_frame=survey_frame) for survey_frame in (False, True))
    seen = [
        (case.cloud.positions + case.cloud.origin_offset - case.pose.position) @ case.pose.rotation
        for case in (plain, turned)
    ]
    np.testing.assert_allclose(seen[0], seen[1], atol=2e-6)
    assert not np.allclose(plain.pose.rotation, turned.pose.rotation)
