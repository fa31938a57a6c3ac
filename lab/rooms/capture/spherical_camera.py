"""Viewing directions of an equirectangular panorama, and the picture of a scene that it takes.

Convention: camera x forward through the image centre, y left, z up;
azimuth = π − 2π (c + ½)/W, elevation = π/2 − π (r + ½)/H.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.core.panorama.panorama import Panorama
from panoloc.lab.rooms.capture.ray_imaging import PixelGrid, image_of
from panoloc.lab.rooms.scenes.scene import Scene
from panoloc.lab.rooms.scenes.surface import Hits


def viewing_directions(column: NDArray[np.floating], row: NDArray[np.floating], width: int) -> NDArray[np.float64]:
    """Return unit directions (..., 3) in the camera frame of pixel coordinates; pixel centres lie at half-integers."""
    azimuth = np.pi - 2 * np.pi * np.asarray(column, np.float64) / width
    elevation = np.pi / 2 - 2 * np.pi * np.asarray(row, np.float64) / width
    flat = np.cos(elevation)
    return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1)


def pixel_centers(width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return columns and rows (H·W,) of all pixel centres of a panorama, row by row."""
    return _grid(width).centers()


@dataclass(frozen=True, eq=False)
class View:
    """A panorama with what its pixel centres saw: hits (H·W,) along directions in the map frame (H·W, 3)."""

    panorama: Panorama
    hits: Hits
    directions: NDArray[np.float64]
    pose: Pose


def take_view(scene: Scene, pose: Pose, width: int = 1024, color_kind: str = "rgb") -> View:
    """Take a panorama of width x width/2 pixels; color_kind "labels" gives exact label colors, without smoothing."""
    grid = _grid(width)
    color, hits, directions = image_of(scene, pose, grid, color_kind)
    return View(Panorama(color, np.ones(grid.shape, np.bool_)), hits, directions, pose)


def take_panorama(scene: Scene, pose: Pose, width: int = 1024, color_kind: str = "rgb") -> Panorama:
    """Return the panorama of `take_view`."""
    return take_view(scene, pose, width, color_kind).panorama


def _grid(width: int) -> PixelGrid:
    return PixelGrid((width // 2, width), lambda column, row: viewing_directions(column, row, width), 2 * np.pi / width)
