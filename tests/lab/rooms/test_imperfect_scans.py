"""Imperfect scans: stations drift as the recipe says, holes and boxes exist, colors are those of another day."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import Scene, scan_with_truth, suite_cases
from panoloc.lab.rooms.capture.imperfect_scan import (
    Imperfections,
    ImperfectScan,
    draw_drifts,
    scan_imperfectly,
    with_boxes,
)

HOW = Imperfections()
EVERYWHERE = replace(HOW, holes_per_m2=0, ceiling_gone=(0, 0), blind_deg=(0, 0), dark_albedo=1e-6, boxes=0)
GRID_M = 0.25


@pytest.fixture(scope="module")
def scan(room: Scene) -> ImperfectScan:
    return scan_imperfectly(room, HOW, num_points=40_000)


@pytest.fixture(scope="module")
def stations() -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform((-2, -2, 1.3), (2, 2, 1.7), (5, 3))


def moved(pose: Pose, points: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.asarray(points @ pose.rotation.T + pose.position)


def covered_cells(points: NDArray[np.floating]) -> set[tuple[int, ...]]:
    """Return the cells of a horizontal grid in which points (N, 3) lie."""
    return set(map(tuple, np.floor(points[:, :2] / GRID_M).astype(int).tolist()))


def test_the_same_seed_gives_the_same_scan_and_another_seed_another(room: Scene, scan: ImperfectScan) -> None:
    again, other = (scan_imperfectly(room, HOW, num_points=40_000, seed=seed) for seed in (0, 1))
    np.testing.assert_array_equal(again.scan.cloud.positions, scan.scan.cloud.positions)
    np.testing.assert_array_equal(again.scan.cloud.colors, scan.scan.cloud.colors)
    assert not np.array_equal(other.scan.cloud.positions, scan.scan.cloud.positions)


def test_every_pair_of_stations_drifts_apart_within_the_limits(stations: NDArray[np.float64]) -> None:
    for seed in range(20):
        drifts = draw_drifts(stations, HOW, np.random.default_rng(seed))
        for one, other in combinations(drifts, 2):
            ghost = np.linalg.norm(moved(one, stations.mean(0)) - moved(other, stations.mean(0)))
            trace = np.trace(one.rotation.T @ other.rotation)
            assert 0.01 - 1e-9 <= ghost <= 0.05 + 1e-9
            assert 0.099 <= np.degrees(np.arccos((trace - 1) / 2)) <= 0.501


def test_drifts_cancel_over_the_stations_everywhere_in_the_room(stations: NDArray[np.float64]) -> None:
    corners = np.array([(x, y, z) for x in (-3, 3) for y in (-3, 3) for z in (0, 2.6)], float)
    drifts = draw_drifts(stations, HOW, np.random.default_rng(3))
    np.testing.assert_allclose(np.mean([moved(drift, corners) for drift in drifts], axis=0), corners, atol=2e-4)
    assert min(np.abs(moved(drift, corners) - corners).max() for drift in drifts) > 0.005


def test_a_lone_station_does_not_drift(stations: NDArray[np.float64]) -> None:
    (drift,) = draw_drifts(stations[:1], HOW, np.random.default_rng(0))
    np.testing.assert_allclose(drift.matrix, np.eye(4), atol=1e-12)


def test_ghosts_of_the_ceiling_lie_as_far_apart_as_the_recipe_says(room: Scene) -> None:
    scan = scan_imperfectly(room, EVERYWHERE, num_points=60_000)
    shell, points = room.rooms[0], scan.scan.cloud.positions.astype(float)
    middle = np.array([(shell.x0 + shell.x1) / 2, (shell.y0 + shell.y1) / 2, shell.height_m])
    inner = (np.abs(points[:, :2] - middle[:2]) < 0.4 * np.array(shell.size_m)).all(1)  # away from the walls
    on_ceiling = inner & (np.abs(points[:, 2] - shell.height_m) < 0.08)
    heights = []
    for number in range(len(scan.drifts)):
        own = points[on_ceiling & (scan.station == number)]
        # A plane fit gives the height that this station measured at the middle of the ceiling.
        columns = np.column_stack((own[:, :2] - middle[:2], np.ones(len(own))))
        heights.append(np.linalg.lstsq(columns, own[:, 2], rcond=None)[0][2])
    said = [moved(drift, middle)[2] for drift in scan.drifts]
    np.testing.assert_allclose(np.subtract.outer(heights, heights), np.subtract.outer(said, said), atol=0.002)
    assert np.ptp(heights) > 0.008


def test_the_ceiling_has_holes_that_an_exact_scan_does_not_have(room: Scene, scan: ImperfectScan) -> None:
    height_m = room.rooms[0].height_m
    exact, imperfect = (
        covered_cells(points[points[:, 2] > height_m - 0.01])
        for points in (scan_with_truth(room, num_points=40_000).exact_positions, scan.scan.exact_positions)
    )
    assert 0.02 < 1 - len(imperfect & exact) / len(exact) < 0.7


def test_stations_differ_in_exposure_on_the_same_ceiling(room: Scene) -> None:
    scan = scan_imperfectly(room, EVERYWHERE, num_points=40_000)
    ceiling = scan.scan.exact_positions[:, 2] > room.rooms[0].height_m - 0.01
    means = [scan.scan.cloud.colors[ceiling & (scan.station == k)].mean() for k in range(len(scan.drifts))]
    assert np.ptp(means) > 10


def test_a_proxy_is_a_box_around_the_thing_under_the_same_key(room: Scene) -> None:
    boxed = with_boxes(room, 1.0, np.random.default_rng(0))
    assert boxed.keys == room.keys
    changed = [(old, new) for old, new in zip(room.objects, boxed.objects, strict=True) if old is not new]
    assert len(changed) >= 3
    for old, new in changed:
        (old_low, old_high), (low, high) = (
            (points.min(0), points.max(0))
            for points in (np.concatenate([part.vertices for part in thing.pieces[0].parts]) for thing in (old, new))
        )
        assert len(new.pieces[0].parts) == 6
        assert (low <= old_low + 1e-6).all()
        assert (high >= old_high - 1e-6).all()
        np.testing.assert_allclose((low[2], high[2]), (old_low[2], old_high[2]), atol=1e-6)
    assert with_boxes(room, 0.0, np.random.default_rng(0)).objects == room.objects


@pytest.mark.slow
def test_a_photo_and_frames_share_the_scan_of_their_seed() -> None:
    photo, frames = (
        next(suite_cases(f"imperfect/{camera}", [3], width=64, num_points=5000)) for camera in ("photo", "frames4")
    )
    np.testing.assert_array_equal(photo.cloud.positions, frames.cloud.positions)
    assert len(photo.cloud) == 5000
    assert 0 < photo.changed_points.mean() < 0.3
