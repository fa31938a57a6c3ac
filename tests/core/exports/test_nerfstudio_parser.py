"""What nerfstudio's own parser makes of `transforms.json`: its steps, written down from its documentation, with its precision and defaults.

nerfstudio itself is no dependency: it brings three gigabytes. The steps are those of `Nerfstudio._generate_dataparser_outputs`: frames in
the order of their names, intrinsics of the file or of every frame, poses in single precision, centred by their mean and scaled into a cube
of one, points moved by `applied_transform` and the same.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.ply.writer import write_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.exports.tours import GOLDEN, LARGE, PIXEL, POINT, document_of, golden_tour, jpeg, written

CAMERA_MODELS = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "EQUIRECTANGULAR"}
INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy")
PLACES = [np.zeros(3), LARGE]


@dataclass(frozen=True)
class Parsed:
    """Cameras (n, 3, 4) and points (m, 3) in the parser's world, both single precision; intrinsics by camera."""

    files: list[Path]
    cameras: np.ndarray
    intrinsics: list[dict[str, float]]
    points: np.ndarray
    scale: float


def parsed(folder: Path) -> Parsed:
    meta = json.loads((folder / "transforms.json").read_text())
    assert meta["camera_model"] in CAMERA_MODELS
    frames = sorted(meta["frames"], key=lambda frame: str(folder / frame["file_path"]))
    for frame in frames:
        Image.open(folder / frame["file_path"]).close()
    intrinsics = [{name: float(meta[name] if name in meta else frame[name]) for name in INTRINSICS} for frame in frames]
    poses = np.array([frame["transform_matrix"] for frame in frames]).astype(np.float32)
    assert meta["orientation_override"] == "none"  # else the parser turns the world to the mean of the cameras' own up
    mean = poses[:, :3, 3].mean(axis=0)
    cameras = poses[:, :3].copy()
    cameras[:, :, 3] -= mean
    scale = 1 / np.abs(cameras[:, :, 3]).max() if len(cameras) > 1 else np.float32(1)
    cameras[:, :, 3] *= scale
    applied: Any = np.vstack([np.array(meta["applied_transform"]), [0, 0, 0, 1]]).astype(np.float32)
    transform = np.hstack([np.eye(3, dtype=np.float32), -mean[:, None]]) @ applied
    cloud = read_scan(folder / meta["ply_file_path"])
    points = (cloud.positions.astype(np.float64) + cloud.origin_offset).astype(np.float32)
    moved = (np.hstack([points, np.ones((len(points), 1), np.float32)]) @ transform.T) * scale
    return Parsed([folder / frame["file_path"] for frame in frames], cameras, intrinsics, moved, float(scale))


def pixel_of(parsed_: Parsed, number: int, point: np.ndarray) -> np.ndarray:
    """Return where a camera of EQUIRECTANGULAR sees a point: the inverse of the parser's rays."""
    camera, sizes = parsed_.cameras[number].astype(np.float64), parsed_.intrinsics[number]
    x, y, z = camera[:, :3].T @ (point - camera[:, 3])
    theta, phi = np.arctan2(-x, -z), np.arccos(y / np.linalg.norm([x, y, z]))
    return np.array([sizes["cx"] - sizes["fl_x"] * theta / np.pi, sizes["cy"] + sizes["fl_y"] * (phi / np.pi - 0.5)])


def tour_at(place: np.ndarray, folder: Path) -> Tour:
    """Return the golden photo and two more around it, and a scan of one point and its like, all moved to a place."""
    golden = golden_tour().photos[0]
    photos = []
    for name, step in (("b.jpg", [0.0, 0, 0]), ("a.jpg", [3.0, 1, 0]), ("rooms/c.jpg", [-2.0, 2, 0.5])):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(jpeg())
        photos.append(replace(golden, name=name, map_from_camera=Pose(GOLDEN.rotation, GOLDEN.position + place + step)))
    scan = folder / "map.ply"
    positions = (POINT + np.array([[0, 0, 0], [1, 2, 0], [-2, 0, 0.25]])).astype(np.float32)
    write_ply(scan, PointCloud(positions, np.full((3, 3), 90, np.uint8), np.asarray(place), 3))
    return Tour("map_1", tuple(photos), scan=scan)


@pytest.mark.parametrize("place", PLACES, ids=["near", "survey"])
def test_the_parser_sees_a_point_of_the_map_at_its_pixel(tmp_path: Path, place: np.ndarray) -> None:
    found = parsed(written("nerfstudio", tour_at(place, tmp_path), tmp_path))
    assert [file.relative_to(tmp_path).as_posix() for file in found.files] == ["a.jpg", "b.jpg", "rooms/c.jpg"]
    assert np.abs(found.cameras[:, :, 3]).max() == pytest.approx(1)
    np.testing.assert_allclose(pixel_of(found, 1, found.points[0].astype(np.float64)), PIXEL, atol=0.01)


@pytest.mark.parametrize("place", PLACES, ids=["near", "survey"])
def test_distances_in_the_parsers_world_are_those_of_the_map_times_its_scale(tmp_path: Path, place: np.ndarray) -> None:
    found = parsed(written("nerfstudio", tour_at(place, tmp_path), tmp_path))
    apart = np.linalg.norm(found.cameras[0, :, 3] - found.cameras[1, :, 3]) / found.scale
    assert apart == pytest.approx(np.sqrt(10), abs=1e-5)
    assert np.linalg.norm(found.points[1] - found.points[0]) / found.scale == pytest.approx(np.sqrt(5), abs=1e-5)


def test_a_survey_leaves_without_its_offset_and_says_so(tmp_path: Path) -> None:
    document = document_of("nerfstudio", tour_at(LARGE, tmp_path), tmp_path, "transforms.json")
    at = np.array(document["frames"][0]["transform_matrix"])[:3, 3]
    np.testing.assert_allclose(at + document["map_offset_m"], GOLDEN.position + LARGE, atol=1e-8)
    assert np.abs(at).max() < 10


def test_photos_of_several_sizes_have_intrinsics_of_their_own(tmp_path: Path) -> None:
    tour = tour_at(np.zeros(3), tmp_path)
    photos: list[PlacedPhoto] = [*tour.photos[:2], replace(tour.photos[2], width=512, height=256)]
    found = parsed(written("nerfstudio", replace(tour, photos=tuple(photos)), tmp_path))
    assert [each["w"] for each in found.intrinsics] == [2048, 2048, 512]
    assert [each["fl_y"] for each in found.intrinsics] == [1024, 1024, 256]
