"""An empty box of painted walls whose scan and panoramas are known in closed form, without the scene generator.

The room spans (0, 0, 0) to `size_m`, z up. Colours are a function of the point alone, so the scan and every panorama show the
same paint. The panorama is made by the sentence in the conventions, not by the code under test.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.point_cloud import PointCloud

Array = NDArray[np.float64]
_TEXTURE = 96  # pixels per side of a wall's picture
_SAMPLING = 512


@dataclass(frozen=True)
class PaintedBox:
    """A box of `size_m`; `symmetric`: painted alike on both sides of the vertical axis through its middle (180 degrees)."""

    seed: int = 0
    size_m: tuple[float, float, float] = (5.0, 4.0, 2.6)
    symmetric: bool = False
    palette: tuple[tuple[int, int, int], ...] = ()

    @cached_property
    def _pictures(self) -> list[NDArray[np.uint8]]:
        rng = np.random.default_rng(self.seed)
        pictures = []
        for face in range(6):
            if self.palette:
                coarse = np.array(self.palette, np.uint8)[rng.integers(len(self.palette), size=(9, 9))]
                resampling = Image.Resampling.NEAREST
            else:
                base = rng.integers(60, 200, 3) if face < 5 else np.array([205, 205, 200])
                coarse = np.clip(base + rng.normal(0, 45, (11, 11, 3)), 0, 255).astype(np.uint8)
                resampling = Image.Resampling.BICUBIC
            pictures.append(np.asarray(Image.fromarray(coarse).resize((_TEXTURE, _TEXTURE), resampling)))
        return pictures

    def color_at(self, points: Array) -> NDArray[np.uint8]:
        """Return the colours (N, 3) of points (N, 3) on the walls."""
        size = np.array(self.size_m)
        points = np.clip(points, 0, size)
        if self.symmetric:
            far = points[:, 0] > size[0] / 2
            points = points.copy()
            points[far, :2] = size[:2] - points[far, :2]
        gaps = np.concatenate((points, size - points), axis=1)
        face = gaps.argmin(axis=1)
        colors = np.zeros((len(points), 3), np.uint8)
        for number, picture in enumerate(self._pictures):
            here = face == number
            across = [axis for axis in range(3) if axis != number % 3]
            place = (points[here][:, across] / size[across] * (_TEXTURE - 1)).round().astype(int)
            colors[here] = picture[place[:, 0], place[:, 1]]
        return colors

    def scan(self, num_points: int = 24_000, seed: int = 0, origin_offset: Array | None = None) -> PointCloud:
        """Return points spread evenly over all walls, with 2 mm of noise."""
        rng = np.random.default_rng((seed, 1))
        size = np.array(self.size_m)
        areas = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]] * 2)
        face = rng.choice(6, size=num_points, p=areas / areas.sum())
        points = rng.uniform(0, 1, (num_points, 3)) * size
        points[np.arange(num_points), face % 3] = np.where(face < 3, 0.0, size[face % 3])
        noisy = (points + rng.normal(0, 0.002, points.shape)).astype(np.float32)
        offset = np.zeros(3) if origin_offset is None else origin_offset
        return PointCloud(noisy, self.color_at(points), offset, num_points_read=num_points)

    def panorama(self, pose: Pose, height: int = _SAMPLING // 2) -> Panorama:
        """Return what a camera at `pose` inside the box sees."""
        width = 2 * height
        column, row = np.meshgrid(np.arange(width), np.arange(height))
        azimuth = np.pi - 2 * np.pi * (column + 0.5) / width
        elevation = np.pi / 2 - np.pi * (row + 0.5) / height
        in_camera = np.stack(
            (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)), axis=-1
        )
        colors = self.color_along(pose.position, in_camera.reshape(-1, 3) @ pose.rotation.T)
        return Panorama(colors.reshape(height, width, 3), np.ones((height, width), bool))

    def color_along(self, position: Array, directions: Array) -> NDArray[np.uint8]:
        """Return the colours (N, 3) that lie from a position (3,) inside the box along directions (N, 3)."""
        return self.color_at(self.points_along(position, directions))

    def points_along(self, position: Array, directions: Array) -> Array:
        """Return the points (N, 3) of the walls that lie from a position (3,) inside the box along directions (N, 3)."""
        size = np.array(self.size_m)
        with np.errstate(divide="ignore"):
            steps = (np.where(directions > 0, size, 0.0) - position) / directions
        nearest = np.where(directions == 0, np.inf, steps).min(axis=1)
        return np.asarray(position + directions * nearest[:, None])


def rotation_of(yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Array:
    """Return Rz(yaw) · Ry(pitch) · Rx(roll), written out."""
    a, b, c = np.radians((yaw_deg, pitch_deg, roll_deg))
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    return np.asarray(about_z @ about_y @ about_x)
