"""The paper's data sets from tiny folders in their layouts: names, poses, clouds, splits, and what is said when files are missing.

Each pose is checked by its picture: a point of the scan has to show up where the panorama has its colour.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.geometry.projection import project
from panoloc.lab.evaluation.datasets import dataset_scans
from panoloc.lab.evaluation.known_cases import LoadedScan, ScanCases, SourceError
from tests.core.painted_box import PaintedBox, rotation_of
from tests.lab.evaluation.painted_datasets import (
    write_image,
    write_reference_pose,
    write_stanford_pose,
    write_text_cloud,
)

BOX = PaintedBox(seed=3)
POSE = Pose(rotation_of(130.0, 8.0, -5.0), np.array([1.7, 2.4, 1.5]))
HEIGHT = 128


def _agreement(loaded: LoadedScan, name: str) -> float:
    """Return the correlation of the scan's colours with those of the panorama where the known pose puts them."""
    query = loaded.query(name)
    pose = query.poses[0]
    points = loaded.cloud.positions + loaded.cloud.origin_offset
    in_camera = torch.from_numpy((points - pose.position) @ pose.rotation)
    height, width = query.panorama.valid.shape
    u, v = (part.numpy().astype(int) for part in project(in_camera, height, width))
    seen = query.panorama.color[v.clip(0, height - 1), u.clip(0, width - 1)]
    return float(np.corrcoef(seen.ravel(), loaded.cloud.colors.ravel())[0, 1])


def _only(scans: list[ScanCases]) -> ScanCases:
    (scan,) = scans
    return scan


@pytest.fixture
def omniscenes(tmp_path: Path) -> Path:
    for split, device, room, rows in (
        ("change_robot", "robot", "pyebaekRoom_1", 3),
        ("extreme", "extreme", "pyebaekRoom_1", 4),
        ("extreme", "extreme", "weddingHall_1", 4),
    ):
        video = f"{device}_{room}_scene_2"
        write_image(tmp_path / f"{split}_pano" / video / "0001.jpg", BOX.panorama(POSE, HEIGHT).color)
        write_reference_pose(tmp_path / f"{split}_pose" / video / "0001.txt", POSE, rows)
    for room in ("pyebaekRoom_1", "weddingHall_1"):
        write_text_cloud(tmp_path / "pcd" / f"{room}.txt", BOX.scan(4_000))
    return tmp_path


def test_omniscenes_has_one_scan_per_split_and_room(omniscenes: Path) -> None:
    names = [scan.name for scan in dataset_scans("omniscenes", omniscenes)]
    assert names == [
        "omniscenes/change_robot/pyebaekRoom_1",
        "omniscenes/extreme/pyebaekRoom_1",
        "omniscenes/extreme/weddingHall_1",
    ]
    # The paper's name of the split with changes.
    assert _only(dataset_scans("omniscenes", omniscenes, "robot")).group == "omniscenes change_robot"


@pytest.mark.parametrize("split", ["change_robot", "extreme"])
def test_omniscenes_poses_put_the_scan_where_the_picture_shows_it(omniscenes: Path, split: str) -> None:
    scan = dataset_scans("omniscenes", omniscenes, split)[0]
    loaded = scan.load()
    assert len(loaded.cloud) == 4_000
    (query,) = scan.query_names
    assert pose_error(loaded.query(query).poses[0], POSE).within(1e-5, 1e-3)
    assert _agreement(loaded, query) > 0.95


def test_an_unknown_split_is_refused_with_those_that_are_there(omniscenes: Path) -> None:
    with pytest.raises(OptionsError, match="change_robot, extreme"):
        dataset_scans("omniscenes", omniscenes, "handheld")


def test_a_missing_cloud_and_a_missing_pose_are_named(omniscenes: Path) -> None:
    scan = dataset_scans("omniscenes", omniscenes, "robot")[0]
    loaded = scan.load()
    shutil.rmtree(omniscenes / "change_robot_pose")
    with pytest.raises(SourceError, match=r"0001\.txt"):
        loaded.query(scan.query_names[0])
    shutil.rmtree(omniscenes / "pcd")
    with pytest.raises(SourceError, match=r"pyebaekRoom_1\.txt"):
        scan.load()


_STANFORD_STEM = "camera_0a1b_office_3_frame_equirectangular_domain"


@pytest.mark.parametrize("with_euler", [True, False])
@pytest.mark.parametrize("layout", ["published", "reference"])
def test_stanford_poses_put_the_scan_where_the_picture_shows_it(tmp_path: Path, layout: str, with_euler: bool) -> None:
    published = layout == "published"
    images = tmp_path / ("area_1/pano/rgb" if published else "pano/area_1")
    poses = tmp_path / ("area_1/pano/pose" if published else "pose/area_1")
    cloud = tmp_path / ("Area_1/office_3/office_3.txt" if published else "pcd/area_1/office_3.txt")
    write_image(images / f"{_STANFORD_STEM}_rgb.png", BOX.panorama(POSE, HEIGHT).color)
    write_stanford_pose(poses / f"{_STANFORD_STEM}_pose.json", POSE, with_euler)
    write_text_cloud(cloud, BOX.scan(4_000))

    scan = _only(dataset_scans("stanford2d3ds", tmp_path, "area_1"))

    assert scan.name == "stanford/area_1/office_3"
    loaded = scan.load()
    assert pose_error(loaded.query(scan.query_names[0]).poses[0], POSE).within(1e-6, 1e-4)
    assert _agreement(loaded, scan.query_names[0]) > 0.95


def test_the_black_poles_of_stanford_are_missing_and_black_walls_are_not(tmp_path: Path) -> None:
    color = BOX.panorama(POSE, HEIGHT).color.copy()
    color[:10], color[-20:], color[60, :40] = 0, 0, 0
    write_image(tmp_path / "pano/area_1" / f"{_STANFORD_STEM}_rgb.png", color)
    write_stanford_pose(tmp_path / "pose/area_1" / f"{_STANFORD_STEM}_pose.json", POSE, True)
    write_text_cloud(tmp_path / "pcd/area_1/office_3.txt", BOX.scan(2_000))
    scan = _only(dataset_scans("stanford2d3ds", tmp_path))
    valid = scan.load().query(scan.query_names[0]).panorama.valid
    assert not valid[:10].any()
    assert not valid[-20:].any()
    assert valid[12:-22].all()  # two rows beside void are mixed with it


def test_the_aligned_version_of_the_clouds_is_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "area_1/pano/rgb" / f"{_STANFORD_STEM}_rgb.png", BOX.panorama(POSE, HEIGHT).color)
    write_text_cloud(tmp_path / "Stanford3dDataset_v1.2_Aligned_Version/Area_1/office_3/office_3.txt", BOX.scan(100))
    with pytest.raises(SourceError, match="not aligned"):
        _only(dataset_scans("stanford2d3ds", tmp_path)).load()


@pytest.mark.parametrize("name", ["omniscenes", "stanford2d3ds"])
def test_an_empty_folder_says_what_was_expected(tmp_path: Path, name: str) -> None:
    with pytest.raises(SourceError, match=r"expected .* found n"):
        dataset_scans(name, tmp_path)


def test_a_matrix_that_is_no_pose_is_refused(omniscenes: Path) -> None:
    scan = dataset_scans("omniscenes", omniscenes, "robot")[0]
    pose = next((omniscenes / "change_robot_pose").rglob("*.txt"))
    np.savetxt(pose, np.column_stack((2 * np.eye(3), POSE.position)))
    with pytest.raises(SourceError, match="orthonormal"):
        scan.load().query(scan.query_names[0])
