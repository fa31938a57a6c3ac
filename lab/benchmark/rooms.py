"""Painted rooms ready to be searched: scanned, thinned as a registration does, and indexed with about as many starts as asked for."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from panoloc.core.config import StartsConfig
from panoloc.core.index.map_builder import build_map_index
from panoloc.core.index.map_index import MapIndex
from panoloc.core.index.starts import octree_starts
from panoloc.core.options import IndexOptions, ScanOptions
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.voxel_thinning import thin_cloud
from panoloc.lab.benchmark.painted_room import PaintedRoom

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
