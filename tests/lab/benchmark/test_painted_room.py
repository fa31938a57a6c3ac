"""The painted room: its scans and panoramas show the same paint, and its poses are free."""

from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading import read_scan
from panoloc.lab.benchmark import painted_maps
from panoloc.lab.benchmark.painted_maps import write_room_scan
from panoloc.lab.benchmark.painted_room import PaintedRoom

ROOM = PaintedRoom(7)


def distance_to_surfaces(points: np.ndarray) -> np.ndarray:
    """Return how far points (N, 3) are from the nearest face of the room or of a box, metres."""
    gaps = [np.minimum(points, ROOM.size_m - points).min(axis=1)]
    for low, high in zip(*ROOM.boxes, strict=True):
        outside = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1)
        inside = np.minimum(points - low, high - points).min(axis=1)
        gaps.append(np.where(outside > 0, outside, inside))
    nearest: np.ndarray = np.min(np.abs(gaps), axis=0)
    return nearest


def test_a_scan_has_as_many_points_as_asked_for_and_all_lie_on_surfaces() -> None:
    cloud = ROOM.scan(5_000)
    assert len(cloud) == cloud.num_points_read == 5_000
    assert distance_to_surfaces(cloud.positions.astype(float)).max() < 0.02


def test_no_point_of_a_scan_lies_inside_a_box() -> None:
    points = ROOM.scan(20_000).positions
    for low, high in zip(*ROOM.boxes, strict=True):
        assert not ((points > low + 0.02) & (points < high - 0.02)).all(axis=1).any()


def test_a_panorama_shows_the_paint_that_the_scan_has() -> None:
    pose, width = Pose(np.eye(3), ROOM.pose().position), 512
    cloud = ROOM.scan(4_000)
    ray = cloud.positions - pose.position
    # By the sentence in the conventions, with the axes of the map.
    column = ((np.pi - np.arctan2(ray[:, 1], ray[:, 0])) / (2 * np.pi) * width).astype(int).clip(0, width - 1)
    elevation = np.arcsin(ray[:, 2] / np.linalg.norm(ray, axis=1))
    row = ((np.pi / 2 - elevation) / np.pi * width / 2).astype(int).clip(0, width // 2 - 1)
    seen = ROOM.panorama(pose, width).color[row, column].astype(float)
    off = np.abs(seen - cloud.colors).max(axis=1)
    # The rest stands behind a box, or at an edge.
    assert np.mean(off < 25) > 0.75


def test_the_same_seed_is_the_same_room_and_another_is_another() -> None:
    again, other = PaintedRoom(7), PaintedRoom(8)
    assert np.array_equal(ROOM.scan(500).positions, again.scan(500).positions)
    assert np.array_equal(ROOM.scan(500).colors, again.scan(500).colors)
    assert not np.array_equal(ROOM.boxes[0], other.boxes[0])
    assert not np.array_equal(ROOM.scan(500).colors, other.scan(500).colors)


@pytest.mark.parametrize("number", range(4))
def test_a_pose_is_a_rotation_at_a_free_place(number: int) -> None:
    pose = ROOM.pose(number)
    assert pose.rotation @ pose.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)
    assert distance_to_surfaces(pose.position[None])[0] >= 0.4 - 1e-9


def test_a_room_without_free_space_says_so() -> None:
    with pytest.raises(OptionsError, match="area_m2: expected a room with free space"):
        PaintedRoom(0, area_m2=0.4).pose()


def test_a_scan_file_holds_what_the_scan_holds(tmp_path: Path) -> None:
    write_room_scan(tmp_path / "room.ply", ROOM, 2_500)
    read, made = read_scan(tmp_path / "room.ply"), ROOM.scan(2_500)
    assert np.array_equal(read.positions, made.positions)
    assert np.array_equal(read.colors, made.colors)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["laz", "e57"])
def test_a_scan_file_of_several_stations_is_that_of_the_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    monkeypatch.setattr(painted_maps, "_POINTS_PER_STATION", 2_000)
    path = tmp_path / f"scan.{ending}"
    write_room_scan(path, ROOM, 5_000)
    cloud, expected = read_scan(path, ScanOptions(max_points_used=10_000)), ROOM.scan(5_000)
    assert cloud.num_points_read == 5_000
    assert distance_to_surfaces(cloud.positions + cloud.origin_offset).max() < 0.02
    np.testing.assert_allclose(cloud.colors.mean(axis=0), expected.colors.mean(axis=0), atol=4)


def test_another_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match=r"expected ply, laz or e57, got '\.xyz'"):
        write_room_scan(tmp_path / "room.xyz", ROOM, 10)


def test_a_scan_in_small_pieces_is_as_large() -> None:
    pieces = list(ROOM.scan_chunks(1_000, chunk=300))
    assert sum(len(positions) for positions, _ in pieces) == 1_000
    assert max(len(positions) for positions, _ in pieces) <= 300
