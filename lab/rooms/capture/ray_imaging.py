"""The picture of a scene that a grid of viewing directions takes: light and texture where rays meet it, edges smoothed."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms.materials.labels import LABEL_TABLE, label_number
from panoloc.lab.rooms.scenes.scene import Scene
from panoloc.lab.rooms.scenes.surface import Hits

# Where the four rays of an edge pixel go, in pixels from its centre (a rotated grid).
_SUBPIXELS = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """The pixels of an image and where they look.

    shape: (H, W). looks: unit directions (N, 3) in the camera frame of columns and rows (N,), pixel centres at half-integers.
    pixel_rad: angle that a pixel covers, one for all or (H·W,), row by row.
    """

    shape: tuple[int, int]
    looks: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
    pixel_rad: float | NDArray[np.float64]

    def centers(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return columns and rows (H·W,) of all pixel centres, row by row."""
        height, width = self.shape
        row, column = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
        return column.ravel(), row.ravel()


def image_of(
    scene: Scene, pose: Pose, grid: PixelGrid, color_kind: str = "rgb"
) -> tuple[NDArray[np.uint8], Hits, NDArray[np.float64]]:
    """Return the image (H, W, 3), and what its pixel centres saw: hits (H·W,) along directions in the map frame (H·W, 3).

    color_kind "labels" gives exact label colors, without smoothing.
    """
    column, row = grid.centers()
    directions = grid.looks(column, row) @ pose.rotation.T
    hits = scene.surface.cast(pose.position, directions)
    if color_kind == "labels":
        pixels = label_colors(scene, hits)
    else:
        color = shade(scene, hits, directions, _footprints(scene, hits, directions, grid.pixel_rad))
        _smooth_edges(scene, pose, grid, hits, color, column, row)
        pixels = (color * 255 + 0.5).astype(np.uint8)
    return pixels.reshape(*grid.shape, 3), hits, directions


def shade(
    scene: Scene, hits: Hits, directions: NDArray[np.floating], footprint_m: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the sRGB color in 0..1 (N, 3) of what rays met; texture is averaged over about `footprint_m` (N,)."""
    surface = scene.surface
    color = np.empty((len(hits.triangle), 3), np.float32)
    color[~hits.found] = scene.sky.radiance(directions[~hits.found]) * scene.exposure
    met = Hits(hits.distance[hits.found], hits.triangle[hits.found], hits.weights[hits.found])
    uv = surface.at_hits(surface.uv_m, met)
    reflectance = surface.atlas.sample(surface.texture[met.triangle], uv, footprint_m[hits.found])
    light = surface.at_hits(scene.irradiance, met) * np.float32(scene.exposure)
    glow = surface.glow[met.triangle][:, None]
    color[hits.found] = reflectance * np.where(glow > 0, glow, light)
    # Highlights roll off instead of clipping hard; stored with a gamma of 2.2.
    rolled = np.where(color < 0.4, color, 0.4 + 0.6 * np.tanh((color - 0.4) / 0.6 * 0.8))
    return np.asarray(np.clip(rolled, 0, 1) ** (1 / 2.2), np.float32)


def label_colors(scene: Scene, hits: Hits) -> NDArray[np.uint8]:
    """Return the label color (N, 3) of what rays met; nothing is sky."""
    labels = np.where(hits.found, scene.surface.label[hits.triangle], label_number("sky"))
    return LABEL_TABLE[labels]


def _footprints(
    scene: Scene, hits: Hits, directions: NDArray[np.float64], pixel_rad: float | NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the width in metres (N,) that a pixel covers on the surface, stretched by up to two at grazing angles."""
    cosine = np.abs((scene.surface.normals[hits.triangle] * directions).sum(1))
    stretch = 1 / np.sqrt(np.clip(cosine, 0.2, 1))
    return np.asarray(np.where(hits.found, hits.distance, 1) * pixel_rad * stretch, np.float32)


def _smooth_edges(
    scene: Scene,
    pose: Pose,
    grid: PixelGrid,
    hits: Hits,
    color: NDArray[np.float32],
    column: NDArray[np.float64],
    row: NDArray[np.float64],
) -> None:
    """Replace the color of pixels at edges of surfaces by the mean over four rays."""
    edges = np.flatnonzero(_at_edge(scene, hits, grid.shape))
    total = np.zeros((len(edges), 3), np.float32)
    pixel_rad = grid.pixel_rad[edges] if isinstance(grid.pixel_rad, np.ndarray) else grid.pixel_rad
    for right, down in _SUBPIXELS:
        directions = grid.looks(column[edges] + right, row[edges] + down) @ pose.rotation.T
        sub = scene.surface.cast(pose.position, directions)
        total += shade(scene, sub, directions, _footprints(scene, sub, directions, pixel_rad) * np.float32(0.5))
    color[edges] = total / len(_SUBPIXELS)


def _at_edge(scene: Scene, hits: Hits, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which pixels (H·W,) have a neighbour on another surface; opposite borders of the image count as neighbours."""
    surface = scene.surface
    plane = np.where(hits.found, surface.texture[hits.triangle], -1).reshape(shape)
    normal = surface.normals[hits.triangle].reshape(*shape, 3)
    edge = np.zeros(shape, np.bool_)
    for axis in (0, 1):
        turned = (normal * np.roll(normal, 1, axis)).sum(-1) < 0.95
        differs = (plane != np.roll(plane, 1, axis)) | turned
        edge |= differs | np.roll(differs, -1, axis)
    flat: NDArray[np.bool_] = edge.ravel()
    return flat
