"""From pixels to viewing directions, for each camera model: the inverse of `panoloc.core.camera.lens`, with its conventions."""

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import distort, fisheye_radius, fold_of, project_to_image

Array = NDArray[np.float64]
_ANGLES = 20_000  # of a fisheye, of which its distortion is a table
_ROUNDS = 50
_CLOSE_PX = 0.5


def directions_of(camera: Camera, pixels: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return unit directions (n, 3) of pixels (n, 2), u and v, and which (n,) have one: a pixel beyond a lens's edge has none.

    Where there is none, the direction means nothing.
    """
    u, v = pixels[:, 0], pixels[:, 1]
    across, down = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    if camera.model == "equirectangular":
        found = np.stack([np.cos(down) * np.cos(across), -np.cos(down) * np.sin(across), -np.sin(down)], axis=1)
    elif camera.model == "cylindrical":
        found = np.stack([np.cos(across), -np.sin(across), -down], axis=1)
    elif camera.model == "opencv_fisheye":
        found = _through_fisheye(camera, across, down)
    else:
        right, below = _undistorted(camera, across, down) if camera.distortion else (across, down)
        found = np.stack([np.ones_like(right), -right, -below], axis=1)
    found = found / np.linalg.norm(found, axis=1, keepdims=True)
    back_u, back_v, shown = project_to_image(camera, found)
    off = np.abs(back_u - u)
    if camera.is_whole_sphere:
        off = np.minimum(off, camera.width_px - off)  # left and right edge are one
    inside = (u >= 0) & (u <= camera.width_px) & (v >= 0) & (v <= camera.height_px)
    return found, inside & shown & (np.hypot(off, back_v - v) < _CLOSE_PX)


def _through_fisheye(camera: Camera, across: Array, down: Array) -> Array:
    angles = np.linspace(0, min(fold_of(camera), np.pi), _ANGLES)
    radius = np.hypot(across, down)
    angle = np.interp(radius, fisheye_radius(camera, angles), angles)
    scale = np.sin(angle) / np.maximum(radius, 1e-12)
    return np.stack([np.cos(angle), -across * scale, -down * scale], axis=1)


def _undistorted(camera: Camera, across: Array, down: Array) -> tuple[Array, Array]:
    """Move a guess by what its distorted place is off, again and again: it converges where a distortion does not fold over."""
    right, below = across, down
    for _ in range(_ROUNDS):
        moved_right, moved_below = distort(camera, right, below)
        right, below = right + across - moved_right, below + down - moved_below
    return right, below
