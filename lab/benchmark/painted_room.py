"""A painted room with boxes in it, in closed form: scans of any size and panoramas of known pose, from numpy alone.

`panoloc.lab.rooms` makes rooms that look like rooms, but needs a ray caster for it; how long a query takes hardly
depends on the difference. The paint is a function of the point and of the surface that it lies on, so scans and
panoramas agree exactly.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.point_cloud import PointCloud

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_AREA_M2 = 24.0
_HEIGHT_M = 2.6
_WIDTH_TO_DEPTH = 1.4
_NUM_BOXES = 8
_PAINT_CELL_M = 0.3
_PAINT_CONTRAST = 40.0  # standard deviation, of 255
_RANGE_NOISE_M = 0.003
_COLOR_NOISE = 3.0
_CLEARANCE_M = 0.4
_ROWS_AT_ONCE = 128


@dataclass(frozen=True)
class PaintedRoom:
    """A room over (0, 0, 0) to `size_m`, z up, with boxes that stand on its floor; the same seed gives the same room."""

    seed: int = 0

    @cached_property
    def size_m(self) -> Array:
        """Return the lengths of the edges (3,), metres."""
        depth = (_AREA_M2 / _WIDTH_TO_DEPTH) ** 0.5
        return np.array([_WIDTH_TO_DEPTH * depth, depth, _HEIGHT_M])

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """Return the least and greatest corners of the boxes, each (B, 3) metres; they may overlap."""
        rng = np.random.default_rng((self.seed, 1))
        extent = rng.uniform((0.4, 0.4, 0.4), (1.2, 0.8, 1.8), (_NUM_BOXES, 3))
        lower = rng.uniform(0, 1, (_NUM_BOXES, 3)) * (self.size_m - extent)
        lower[:, 2] = 0
        # Along the walls, as furniture stands, so that the middle stays free for cameras.
        wall = rng.integers(0, 4, _NUM_BOXES)
        for number, axis in enumerate(wall % 2):
            lower[number, axis] = 0 if wall[number] < 2 else self.size_m[axis] - extent[number, axis]
        return lower, lower + extent

    @cached_property
    def _paint(self) -> tuple[Array, NDArray[np.float32]]:
        """Return the colour of each surface (6 + B, 3) and a lattice of deviations from it, one node every `_PAINT_CELL_M`."""
        rng = np.random.default_rng((self.seed, 2))
        nodes = np.ceil(self.size_m / _PAINT_CELL_M).astype(int) + 2
        lattice = rng.normal(0, _PAINT_CONTRAST, (*nodes, 3)).astype(np.float32)
        return rng.uniform(60, 200, (6 + _NUM_BOXES, 3)), lattice

    def color_at(self, points: Array, surface: NDArray[np.int64]) -> Array:
        """Return the paint (N, 3) in 0..255 at points (N, 3) of surfaces (N,): 0 to 5 the room's faces, then the boxes."""
        base, lattice = self._paint
        scaled = np.clip(points / _PAINT_CELL_M, 0, np.array(lattice.shape[:3]) - 1.001)
        node = scaled.astype(np.int64)
        share = scaled - node
        color = base[surface]
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, share, 1 - share), axis=1)
            x, y, z = (node + corner).T
            color += weight[:, None] * lattice[x, y, z]
        return np.clip(color, 0, 255)

    def scan(self, num_points: int, seed: int = 0) -> PointCloud:
        """Return a scan of `num_points` points, evenly over all surfaces, with noise on positions and colours."""
        chunks = list(self.scan_chunks(num_points, seed=seed))
        positions, colors = (np.concatenate(column) for column in zip(*chunks, strict=True))
        return PointCloud(positions, colors, num_points_read=num_points)

    def scan_chunks(
        self, num_points: int, chunk: int = 1_000_000, seed: int = 0
    ) -> Iterator[tuple[NDArray[np.float32], Bytes]]:
        """Yield the points of a scan, at most `chunk` at a time: positions (n, 3) metres and colours (n, 3)."""
        rng = np.random.default_rng((self.seed, 3, seed))
        left = num_points
        while left:
            # Some of what is drawn lies hidden behind boxes, so a little more is drawn than is missing.
            drawn, surfaces = self._surface_points(rng, min(int(1.3 * left) + 16, chunk))
            points, surface = drawn[:left], surfaces[:left]
            colors = self.color_at(points, surface) + rng.normal(0, _COLOR_NOISE, points.shape)
            noisy = points + rng.normal(0, _RANGE_NOISE_M, points.shape)
            yield noisy.astype(np.float32), np.clip(colors, 0, 255).astype(np.uint8)
            left -= len(points)

    def _surface_points(self, rng: np.random.Generator, count: int) -> tuple[Array, NDArray[np.int64]]:
        """Draw points on what a scanner can see, (n, 3), n up to `count`, and the surfaces that they lie on (n,)."""
        lower = np.vstack((np.zeros(3), self.boxes[0]))
        upper = np.vstack((self.size_m, self.boxes[1]))
        edge = upper - lower
        areas = np.stack([edge[:, (axis + 1) % 3] * edge[:, (axis + 2) % 3] for axis in (0, 1, 2, 0, 1, 2)], axis=1)
        areas[1:, 2] = 0  # boxes have no underside
        drawn = rng.choice(areas.size, count, p=(areas / areas.sum()).ravel())
        solid, face = np.divmod(drawn, 6)
        points = lower[solid] + rng.uniform(0, 1, (count, 3)) * edge[solid]
        axis = face % 3
        points[np.arange(count), axis] = np.where(face < 3, lower[solid, axis], upper[solid, axis])
        seen = ~self._hidden(points)
        return points[seen], np.where(solid == 0, face, solid + 5)[seen]

    def _hidden(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (N, 3) lie inside a box, on the floor below one, or on the wall behind one."""
        grown = 1e-6
        hidden = np.zeros(len(points), np.bool_)
        for low, high in zip(*self.boxes, strict=True):
            at_wall = np.where(low <= 0, low - 1, low + grown), np.where(high >= self.size_m, high + 1, high - grown)
            hidden |= ((points > at_wall[0]) & (points < at_wall[1])).all(axis=1)
        return hidden

    def pose(self, number: int = 0) -> Pose:
        """Return one of the poses to take panoramas from, in any orientation, 0.4 m from everything."""
        rng = np.random.default_rng((self.seed, 4, number))
        drawn = rng.uniform(0, 1, (512, 3)) * self.size_m
        free = ((drawn >= _CLEARANCE_M) & (drawn <= self.size_m - _CLEARANCE_M)).all(axis=1)
        for low, high in zip(*self.boxes, strict=True):
            free &= ((drawn < low - _CLEARANCE_M) | (drawn > high + _CLEARANCE_M)).any(axis=1)
        return Pose(_random_rotation(rng), drawn[free][0])

    def panorama(self, pose: Pose, width: int) -> Panorama:
        """Return the panorama of `width` x `width` / 2 pixels that a camera at `pose` takes."""
        rows = range(0, width // 2, _ROWS_AT_ONCE)
        parts = [self._pixels(pose, width, first, min(first + _ROWS_AT_ONCE, width // 2)) for first in rows]
        color = np.concatenate(parts)
        return Panorama(color, np.ones(color.shape[:2], np.bool_))

    def _pixels(self, pose: Pose, width: int, first: int, last: int) -> Bytes:
        """Return the rows `first` to `last` of a panorama, (last − first, width, 3)."""
        row, column = np.meshgrid(np.arange(first, last) + 0.5, np.arange(width) + 0.5, indexing="ij")
        azimuth, elevation = np.pi - 2 * np.pi * column / width, np.pi / 2 - 2 * np.pi * row / width
        flat = np.cos(elevation)
        camera = np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1).reshape(-1, 3)
        rays = camera @ pose.rotation.T
        distance, surface = self._first_hit(pose.position, np.where(rays == 0, 1e-12, rays))
        color = self.color_at(pose.position + rays * distance[:, None], surface)
        return color.round().astype(np.uint8).reshape(last - first, width, 3)

    def _first_hit(self, origin: Array, rays: Array) -> tuple[Array, NDArray[np.int64]]:
        """Return the distance (N,) to what rays (N, 3) from inside the room meet, metres, and its surface (N,)."""
        exits = (np.where(rays > 0, self.size_m, 0.0) - origin) / rays
        axis = exits.argmin(axis=1)
        distance = exits.min(axis=1)
        surface = axis + 3 * (np.take_along_axis(rays, axis[:, None], 1)[:, 0] > 0)
        for number, (low, high) in enumerate(zip(*self.boxes, strict=True)):
            one, other = (low - origin) / rays, (high - origin) / rays
            enters, leaves = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
            nearer = (enters > 0) & (enters < leaves) & (enters < distance)
            distance = np.where(nearer, enters, distance)
            surface = np.where(nearer, 6 + number, surface)
        return distance, surface


def _random_rotation(rng: np.random.Generator) -> Array:
    """Draw a rotation (3, 3), uniform on SO(3)."""
    orthonormal, upper = np.linalg.qr(rng.normal(size=(3, 3)))
    orthonormal *= np.sign(np.diag(upper))
    return np.asarray(orthonormal * np.linalg.det(orthonormal))
