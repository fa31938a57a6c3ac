"""What a scan contains: only what a station sees, with the noise that was asked for."""

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.lab.rooms import Scan, Scene, scan_scene, scan_with_truth, take_panorama
from panoloc.lab.rooms.capture.free_space import sample_pose
from panoloc.lab.rooms.materials.labels import LABEL_COLORS
from panoloc.lab.rooms.scenes.surface import Surface


def first_hit(surface: Surface, start: NDArray[np.floating], end: NDArray[np.floating]) -> float:
    """Return the share of the way from start to end at which the first triangle is met (Möller and Trumbore 1997)."""
    a, b, c = (surface.vertices[surface.triangles[:, k]].astype(np.float64) for k in range(3))
    direction = end - start
    normal = np.cross(direction, c - a)
    with np.errstate(all="ignore"):
        scale = (normal * (b - a)).sum(1)
        u = ((start - a) * normal).sum(1) / scale
        q = np.cross(start - a, b - a)
        v = q @ direction / scale
        t = (q * (c - a)).sum(1) / scale
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9)
    return float(t[hit].min()) if hit.any() else np.inf


@pytest.mark.slow
def test_every_scanned_point_is_the_first_thing_that_some_station_sees(flat: Scene) -> None:
    scan = scan_with_truth(flat, num_points=20_000)
    assert len(scan.cloud) == 20_000
    x, y, _ = scan.cloud.positions.T
    for room in flat.rooms:
        assert ((x > room.x0) & (x < room.x1) & (y > room.y0) & (y < room.y1)).sum() > 600
    for point in scan.exact_positions[np.random.default_rng(0).permutation(len(scan.cloud))[:25]]:
        nearest_first = scan.stations[np.argsort(np.linalg.norm(scan.stations - point, axis=1))]
        assert any(abs(first_hit(flat.surface, station, point) - 1) < 1e-3 for station in nearest_first)


def test_nothing_is_scanned_behind_the_walls(room: Scene, room_scan: Scan) -> None:
    shell = room.rooms[0]
    low, high = room_scan.cloud.bounds
    deepest = max(hole.depth_m for hole in shell.openings) + 0.03
    assert (low[:2] > (shell.x0 - deepest, shell.y0 - deepest)).all()
    assert (high[:2] < (shell.x1 + deepest, shell.y1 + deepest)).all()
    assert -0.03 < low[2] < 0.03
    assert abs(high[2] - shell.height_m) < 0.03


def test_range_noise_has_the_deviation_that_was_asked_for(room_scan: Scan) -> None:
    off = np.linalg.norm(room_scan.cloud.positions - room_scan.exact_positions, axis=1)
    assert 0.0036 < np.sqrt((off**2).mean()) < 0.0044


def test_label_scans_and_panoramas_hold_nothing_but_label_colors(room: Scene) -> None:
    known = set(LABEL_COLORS.values())
    pose = sample_pose(room, np.random.default_rng(0))
    panorama = take_panorama(room, pose, 256, "labels")
    cloud = scan_scene(room, num_points=20_000, color_kind="labels")
    for colors in (panorama.color.reshape(-1, 3), cloud.colors):
        assert set(map(tuple, np.unique(colors, axis=0).tolist())) <= known
    assert len(np.unique(cloud.colors, axis=0)) >= 8
