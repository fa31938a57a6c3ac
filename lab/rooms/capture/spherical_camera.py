"""Viewing directions of an equirectangular panorama, and the picture of a scene that it takes.

Convention: camera x forward through the image centre, y left, z up;
azimuth = π − 2π (c + ½)/W, elevation = π/2 − π (r + ½)/H.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.geometry.pose import Pose
from core.panorama.panorama import Panorama
from lab.rooms.materials.labels import LABEL_TABLE, label_number
from lab.rooms.scenes.scene import Scene
from lab.rooms.scenes.surface import Hits

# Where the four rays of an edge pixel go, in pixels from its centre (a rotated grid).
_SUBPIXELS = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))


def viewing_directions(column: NDArray[np.floating], row: NDArray[np.floating], width: int) -> NDArray[np.float64]:
    """Return unit directions (..., 3) in the camera frame of pixel coordinates; pixel centres lie at half-integers."""
    azimuth = np.pi - 2 * np.pi * np.asarray(column, np.float64) / width
    elevation = np.pi / 2 - 2 * np.pi * np.asarray(row, np.float64) / width
    flat = np.cos(elevation)
    return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1)


def pixel_centers(width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return columns and rows (H·W,) of all pixel centres of a panorama, row by row."""
    row, column = np.meshgrid(np.arange(width // 2) + 0.5, np.arange(width) + 0.5, indexing="ij")
    return column.ravel(), row.ravel()


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
    return tone_mapped(color)


def tone_mapped(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return sRGB values (gamma 2.2) of linear light; highlights roll off instead of clipping hard."""
    rolled = np.where(linear < 0.4, linear, 0.4 + 0.6 * np.tanh((linear - 0.4) / 0.6 * 0.8))
    return np.asarray(np.clip(rolled, 0, 1) ** (1 / 2.2), np.float32)


@dataclass(frozen=True, eq=False)
class View:
    """A panorama with what its pixel centres saw: hits (H·W,) along directions in the map frame (H·W, 3)."""

    panorama: Panorama
    hits: Hits
    directions: NDArray[np.float64]
    pose: Pose


def take_view(scene: Scene, pose: Pose, width: int = 1024, color_kind: str = "rgb") -> View:
    """Take a panorama of width x width/2 pixels; color_kind "labels" gives exact label colors, without smoothing."""
    column, row = pixel_centers(width)
    directions = viewing_directions(column, row, width) @ pose.rotation.T
    hits = scene.surface.cast(pose.position, directions)
    if color_kind == "labels":
        pixels = label_colors(scene, hits)
    else:
        color = shade(scene, hits, directions, _footprints(scene, hits, directions, width))
        _smooth_edges(scene, pose, width, hits, color, column, row)
        pixels = (color * 255 + 0.5).astype(np.uint8)
    height = width // 2
    valid = np.ones((height, width), np.bool_)
    return View(Panorama(pixels.reshape(height, width, 3), valid), hits, directions, pose)


def take_panorama(scene: Scene, pose: Pose, width: int = 1024, color_kind: str = "rgb") -> Panorama:
    """Return the panorama of `take_view`."""
    return take_view(scene, pose, width, color_kind).panorama


def label_colors(scene: Scene, hits: Hits) -> NDArray[np.uint8]:
    """Return the label color (N, 3) of what rays met; nothing is sky."""
    labels = np.where(hits.found, scene.surface.label[hits.triangle], label_number("sky"))
    return LABEL_TABLE[labels]


def _footprints(scene: Scene, hits: Hits, directions: NDArray[np.float64], width: int) -> NDArray[np.float32]:
    """Return the width in metres (N,) that a pixel covers on the surface, stretched by up to two at grazing angles."""
    cosine = np.abs((scene.surface.normals[hits.triangle] * directions).sum(1))
    stretch = 1 / np.sqrt(np.clip(cosine, 0.2, 1))
    return np.asarray(np.where(hits.found, hits.distance, 1) * (2 * np.pi / width) * stretch, np.float32)


def _smooth_edges(
    scene: Scene,
    pose: Pose,
    width: int,
    hits: Hits,
    color: NDArray[np.float32],
    column: NDArray[np.float64],
    row: NDArray[np.float64],
) -> None:
    """Replace the color of pixels at edges of surfaces by the mean over four rays."""
    edges = np.flatnonzero(_at_edge(scene, hits, width))
    total = np.zeros((len(edges), 3), np.float32)
    for right, down in _SUBPIXELS:
        directions = viewing_directions(column[edges] + right, row[edges] + down, width) @ pose.rotation.T
        sub = scene.surface.cast(pose.position, directions)
        total += shade(scene, sub, directions, _footprints(scene, sub, directions, width) * np.float32(0.5))
    color[edges] = total / len(_SUBPIXELS)


def _at_edge(scene: Scene, hits: Hits, width: int) -> NDArray[np.bool_]:
    surface = scene.surface
    shape = (width // 2, width)
    plane = np.where(hits.found, surface.texture[hits.triangle], -1).reshape(shape)
    normal = surface.normals[hits.triangle].reshape(*shape, 3)
    edge = np.zeros(shape, np.bool_)
    for axis in (0, 1):
        turned = (normal * np.roll(normal, 1, axis)).sum(-1) < 0.95
        differs = (plane != np.roll(plane, 1, axis)) | turned
        edge |= differs | np.roll(differs, -1, axis)
    flat: NDArray[np.bool_] = edge.ravel()
    return flat
