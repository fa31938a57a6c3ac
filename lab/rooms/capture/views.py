"""The pictures that cameras take: panoramas of a scene, photos of any camera model, and photos cut out of a panorama.

Convention: camera x forward through the image centre, y left, z up; in a panorama azimuth = π − 2π (c + ½)/W and elevation =
π/2 − π (r + ½)/H.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import project, sample_bilinear
from panoloc.core.survey.rays import directions_of
from panoloc.lab.rooms.capture.ray_imaging import PixelGrid, image_of
from panoloc.lab.rooms.scenes.scene import Scene
from panoloc.lab.rooms.scenes.surface import Hits

_SURELY_VALID = 0.999  # of the weights of the four pixels that one is mixed of


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


@dataclass(frozen=True, eq=False)
class PhotoView:
    """A photo with what its pixel centres saw: hits (h·w,) along directions in the map frame (h·w, 3).

    pose: map_from_camera. Pixels that the lens does not reach are black and not valid; their hits mean nothing.
    """

    photo: Photo
    hits: Hits
    directions: NDArray[np.float64]
    pose: Pose


def take_photo(scene: Scene, camera: Camera, pose: Pose, color_kind: str = "rgb") -> PhotoView:
    """Take a photo as the camera's model draws it; color_kind "labels" gives exact label colors, without smoothing."""
    shape = camera.height_px, camera.width_px

    def looks(column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        return _rays(camera, column, row)[0]

    seen, reached = _rays(camera, *PixelGrid(shape, looks, 0.0).centers())
    valid = reached.reshape(shape)
    # The chord to the next pixel is the angle, to a millionth.
    steps = np.linalg.norm(np.diff(seen.reshape(*shape, 3), axis=1), axis=-1).clip(1e-5, 0.1)
    angles = np.pad(steps, ((0, 0), (0, 1)), mode="edge").ravel()
    color, hits, directions = image_of(scene, pose, PixelGrid(shape, looks, angles), color_kind)
    return PhotoView(Photo(color * valid[..., None], valid, camera), hits, directions, pose)


def _rays(
    camera: Camera, column: NDArray[np.float64], row: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return directions (N, 3) of pixels, those that the lens does not reach straight ahead, and which it reaches (N,)."""
    directions, shown = directions_of(camera, column, row)
    directions[~np.isfinite(directions).all(-1)] = (1.0, 0.0, 0.0)
    return directions, shown


def cut_photo(panorama: Panorama, camera: Camera, panorama_from_camera: NDArray[np.float64]) -> Photo:
    """Return the photo that a camera turned by `panorama_from_camera` (3, 3) takes at the place of the panorama.

    A pixel is valid where the lens shows something and all that it is mixed of is valid. A panorama finer than the photo is averaged down
    first.
    """
    panorama = _no_finer(panorama, min(camera.fx_px, camera.fy_px))
    row, column = np.meshgrid(np.arange(camera.height_px) + 0.5, np.arange(camera.width_px) + 0.5, indexing="ij")
    directions, shown = directions_of(camera, column, row)
    height, width = panorama.valid.shape
    u, v = project(torch.from_numpy(np.nan_to_num(directions) @ panorama_from_camera.T), height, width)
    planes = np.concatenate((panorama.color, 255 * panorama.valid[..., None]), axis=-1).astype(np.float64)
    sampled = sample_bilinear(torch.from_numpy(planes).permute(2, 0, 1).contiguous(), u, v).numpy()
    valid = shown & (sampled[..., 3] > 255 * _SURELY_VALID)
    color = np.clip(sampled[..., :3] + 0.5, 0, 255).astype(np.uint8)
    return Photo(color * valid[..., None], valid, camera)


def _no_finer(panorama: Panorama, px_per_rad: float) -> Panorama:
    """Return the panorama, averaged down by a whole factor where it has several pixels to one of the photo."""
    height = len(panorama.valid)
    factor = int(height / math.pi / px_per_rad)
    if factor < 2:
        return panorama
    size = (2 * (height // factor), height // factor)
    color = np.asarray(Image.fromarray(panorama.color).resize(size, Image.Resampling.BOX))
    share = np.asarray(Image.fromarray(panorama.valid.astype(np.uint8) * 255).resize(size, Image.Resampling.BOX))
    return Panorama(color, share == 255)
