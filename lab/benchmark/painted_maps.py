"""Scans of painted rooms as files, written in pieces so that large ones need little memory, and their maps, ready to be searched."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from panoloc.core.config import StartsConfig
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.starts import octree_starts
from panoloc.core.options import IndexOptions, ScanOptions
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.voxel_thinning import thin_cloud
from panoloc.lab.benchmark.painted_room import PaintedRoom
from panoloc.lab.benchmark.timing import Say

_LAZ_STEP_M = 0.0005
_POINTS_PER_STATION = 5_000_000
_SAMPLE_POINTS = 50_000
_SPACING_STEPS = 8
_LEAST_SPACING_M, _GREATEST_SPACING_M = 0.05, 50.0


@dataclass(frozen=True)
class IndexedRoom:
    """A room and the index of its scan."""

    room: PaintedRoom
    index: MapIndex


class Rooms:
    """Makes rooms when they are first asked for, and keeps them for the parts of one run that share them.

    say: receives what is being made.
    """

    def __init__(self, device: torch.device, say: Callable[[str], None] = lambda text: None) -> None:
        self._device, self._say = device, say
        self._made: dict[tuple[int, int, int], IndexedRoom] = {}

    def indexed(self, seed: int, points: int, starts: int) -> IndexedRoom:
        """Return a room whose scan has `points` points before thinning, and whose index has about `starts` starts."""
        key = (seed, points, starts)
        if key not in self._made:
            self._say(f"making a room: {points:,} points, about {starts} starts")
            room = PaintedRoom(seed)
            cloud = thin_cloud(room.scan(points), ScanOptions().max_points_used)
            options = IndexOptions(spacing_m=spacing_for(cloud, starts))
            self._made[key] = IndexedRoom(room, build_map_index(cloud, options, device=self._device))
        return self._made[key]


def spacing_for(cloud: PointCloud, starts: int) -> float:
    """Return the spacing of starts, metres, that puts about `starts` of them into the free space of a cloud."""
    sample = cloud.positions[:: max(1, len(cloud) // _SAMPLE_POINTS)]
    spacing, best, least_off = StartsConfig().spacing_m, StartsConfig().spacing_m, float("inf")
    for _ in range(_SPACING_STEPS):
        found = len(octree_starts(sample, StartsConfig(spacing_m=spacing, max_starts=100 * starts)))
        off = abs(found - starts) / starts
        if off < least_off:
            best, least_off = spacing, off
        # Starts fill a volume, so their number goes with the cube of the spacing.
        spacing = min(max(spacing * (found / starts) ** (1 / 3), _LEAST_SPACING_M), _GREATEST_SPACING_M)
    return best


def room_spacing(points: int, starts: int) -> float:
    """Return the spacing, metres, that puts about `starts` starts into the map of a painted room scanned with `points` points."""
    return spacing_for(PaintedRoom(0).scan(min(points, 2 * _SAMPLE_POINTS)), starts)


def write_room_scan(path: Path, room: PaintedRoom, num_points: int, say: Say = lambda text: None) -> None:
    """Write a scan of `num_points` points in the format that the ending names: ply, laz or e57.

    say: receives what is being written. Raises OSError when the disk is full.
    """
    say(f"writing a scan of {num_points:,} points")
    {".ply": _write_ply, ".laz": _write_laz, ".e57": _write_e57}[path.suffix](path, room, num_points)


def _write_ply(path: Path, room: PaintedRoom, num_points: int) -> None:
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {num_points}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    with path.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        for positions, colors in room.scan_chunks(num_points):
            rows = np.empty(len(positions), [("position", "<f4", 3), ("color", "u1", 3)])
            rows["position"], rows["color"] = positions, colors
            file.write(rows.tobytes())


def _write_laz(path: Path, room: PaintedRoom, num_points: int) -> None:
    """Write LAZ 1.4 with colours of 16 bits."""
    import laspy

    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales = np.full(3, _LAZ_STEP_M)
    with laspy.open(path, mode="w", header=header, laz_backend=laspy.LazBackend.Lazrs) as file:
        for positions, colors in room.scan_chunks(num_points):
            points = laspy.ScaleAwarePointRecord.zeros(len(positions), header=header)
            points.x, points.y, points.z = positions.astype(np.float64).T
            points.red, points.green, points.blue = colors.astype(np.uint16).T * 257
            file.write_points(points)


def _write_e57(path: Path, room: PaintedRoom, num_points: int) -> None:
    """Write stations of five million points, each turned about a place of its own."""
    from pye57 import E57

    file = E57(str(path), mode="w")
    for number, first in enumerate(range(0, num_points, _POINTS_PER_STATION)):
        angle, place = 0.7 * number, np.array([1.0 + 0.1 * number, 1.5, 1.6])
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        cloud = room.scan(min(_POINTS_PER_STATION, num_points - first), seed=number)
        local = ((cloud.positions - place) @ turn).astype(np.float32).astype(np.float64)
        columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), local.T, strict=True))
        columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), cloud.colors.T, strict=True))
        rotation = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        file.write_scan_raw(columns, rotation=rotation, translation=place)
    file.close()
