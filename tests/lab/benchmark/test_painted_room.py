"""The painted room: its scans and panoramas show the same paint, and its poses are free."""

from pathlib import Path

import numpy as np

from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.reading import read_scan
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
    for low, high in zip(*ROOM.boxes, strict=True):
        assert not ((cloud.positions > low + 0.02) & (cloud.positions < high - 0.02)).all(axis=1).any()


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


def test_a_scan_file_holds_what_the_scan_holds(tmp_path: Path) -> None:
    write_room_scan(tmp_path / "room.ply", ROOM, 2_500)
    read, made = read_scan(tmp_path / "room.ply"), ROOM.scan(2_500)
    assert np.array_equal(read.positions, made.positions)
    assert np.array_equal(read.colors, made.colors)
