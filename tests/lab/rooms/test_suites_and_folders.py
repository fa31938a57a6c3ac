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
    SceneSpec,
    build_scene,
    make_case,
    sample_pose,
    suite_cases,
    take_panorama,
    write_case_folder,
)
from panoloc.lab.rooms.materials.labels import LABEL_COLORS
from panoloc.lab.rooms.scenes.twin_scene import twin_poses
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
    if case.color_kind == "labels":
        shown = set(map(tuple, np.unique(case.panorama.color.reshape(-1, 3), axis=0).tolist()))
        assert shown <= set(LABEL_COLORS.values())
    else:
        assert case.panorama.color.std() > 8


@pytest.mark.slow
def test_cases_are_made_one_by_one_and_only_when_asked_for() -> None:
    cases = suite_cases("labels", range(10**9), width=64)
    assert next(cases).seed == 0


@pytest.mark.slow
def test_the_region_of_the_street_holds_the_camera() -> None:
    case = made("street", 5)
    assert case.region is not None
    assert (np.array(case.region[0]) <= case.pose.position).all()
    assert (case.pose.position <= np.array(case.region[1])).all()


@pytest.mark.slow
def test_held_out_families_are_respected() -> None:
    suite = replace(SUITES["rooms"], num_points=2000)
    case, same = (make_case("rooms", suite, 4, families, 64) for families in (["office"], ["office"]))
    other = make_case("rooms", suite, 4, ["classic"], 64)
    np.testing.assert_array_equal(case.cloud.colors, same.cloud.colors)
    assert case.cloud.colors.mean() != other.cloud.colors.mean()


def test_an_unknown_suite_or_family_is_refused_at_once() -> None:
    with pytest.raises(OptionsError, match="changed"):
        suite_cases("underwater", [0])
    with pytest.raises(OptionsError, match="nordic"):
        suite_cases("rooms", [0], families=["baroque"])


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


def test_label_panoramas_are_written_without_loss(tmp_path: Path) -> None:
    case = made("labels", 2, width=128)
    truth = written(case, tmp_path)
    assert truth["color_kind"] == "labels"
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / truth["queries"][0]["image"])), case.panorama.color)


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


def test_both_poses_in_twin_rooms_show_the_same_picture() -> None:
    scene = build_scene(SceneSpec("twins", 3, area_m2=10.0))
    pose = sample_pose(scene, np.random.default_rng(1), "any")
    (other,) = twin_poses(scene, pose)
    assert np.linalg.norm(other.position - pose.position) > 2
    first, second = (take_panorama(scene, where, 256, "labels").color for where in (pose, other))
    assert (first == second).all(-1).mean() > 0.995


@pytest.mark.slow
def test_a_partial_panorama_masks_what_it_does_not_show() -> None:
    case = made("partial", 1, 500)
    assert case.panorama.valid[8:24].all()
    assert not case.panorama.valid[:8].any()
    assert not case.panorama.valid[24:].any()
