"""The photo of a scene that a camera of any model takes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.camera.camera import Camera
from core.camera.pixel_rays import rays_of_pixels
from core.geometry.pose import Pose
from core.panorama.session import Photo
from lab.rooms.capture.ray_imaging import PixelGrid, image_of
from lab.rooms.scenes.scene import Scene
from lab.rooms.scenes.surface import Hits


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
    directions, shown = rays_of_pixels(camera, column, row)
    directions[~np.isfinite(directions).all(-1)] = (1.0, 0.0, 0.0)
    return directions, shown
