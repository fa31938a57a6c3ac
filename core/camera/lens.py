"""From viewing directions to pixels, for each camera model.

Convention: camera frame x forward along the optical axis, y left, z up; pixel coordinates `u` to the right and `v` down from the top-left
corner, pixel centres at half-integers. With X = -y, Y = -z, Z = x these are the axes in which OpenCV defines its models
(https://docs.opencv.org, "Camera Calibration and 3D Reconstruction" and "Fisheye camera model").
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import MAX_HFOV_DEG, Camera

Array = NDArray[np.float64]
MAX_PINHOLE_RAD = math.radians(MAX_HFOV_DEG["pinhole"] / 2)  # from the axis
_FOLD_STEPS = 2048
_GRID = 32  # on each side of an image


def project_to_image(camera: Camera, directions: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return pixel coordinates u, v (...) of directions (..., 3), not necessarily unit, and which of them (...) the image shows.

    Where a direction is not shown, u and v mean nothing. A distortion whose polynomial turns back on itself shows nothing beyond that
    angle, where two directions would share a pixel.
    """
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    if camera.model in ("equirectangular", "cylindrical"):
        across = -np.arctan2(y, x)
        flat = np.hypot(x, y)
        down = -np.arctan2(z, flat) if camera.model == "equirectangular" else -z / np.maximum(flat, 1e-12)
        shown = np.ones(x.shape, bool)
    else:
        across, down, shown = _through_lens(camera, -y, -z, x)
    u, v = camera.fx_px * across + camera.cx_px, camera.fy_px * down + camera.cy_px
    inside = (u >= 0) & (u <= camera.width_px) & (v >= 0) & (v <= camera.height_px)
    return u, v, shown & inside


def _through_lens(camera: Camera, right: Array, below: Array, ahead: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return distorted image coordinates in focal lengths, and which directions the lens takes in."""
    off_axis = np.hypot(right, below)
    if camera.model == "opencv_fisheye":
        angle = np.arctan2(off_axis, ahead)
        scale = fisheye_radius(camera, angle) / np.maximum(off_axis, 1e-12)
        return right * scale, below * scale, angle < fold_of(camera)
    shown = off_axis < math.tan(MAX_PINHOLE_RAD) * ahead
    depth = np.where(shown, ahead, 1.0)
    x, y = right / depth, below / depth
    if not camera.distortion:
        return x, y, shown
    return *distort(camera, x, y), shown & (np.hypot(x, y) < fold_of(camera))


def fold_of(camera: Camera) -> float:
    """Return from which angle (rad, of a fisheye) or radius (focal lengths) on a distortion turns back on itself; infinite if nowhere."""
    if camera.model == "opencv_fisheye":
        return _first_fold(np.linspace(0, math.pi, _FOLD_STEPS), lambda t: fisheye_radius(camera, t))
    radii = np.linspace(0, math.tan(MAX_PINHOLE_RAD), _FOLD_STEPS)
    return _first_fold(radii, lambda r: r * _radial(camera, r * r)) if camera.distortion else math.inf


def share_with_direction(camera: Camera) -> float:
    """Return the share of an image, 0..1, whose pixels have a direction: none has beyond where a distortion turns back on itself."""
    fold = fold_of(camera)
    if camera.model not in ("opencv", "opencv_fisheye") or fold == math.inf:
        return 1.0
    at_fold = np.array(fold)
    reach = fisheye_radius(camera, at_fold) if camera.model == "opencv_fisheye" else fold * _radial(camera, at_fold**2)
    u, v = ((np.arange(_GRID) + 0.5) * side / _GRID for side in (camera.width_px, camera.height_px))
    across, down = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    return float((np.hypot(across[:, None], down) <= reach).mean())


def distort(camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
    """Return distorted coordinates of a camera that has a distortion, all in focal lengths."""
    p1, p2 = camera.distortion[2:4]
    square = x * x + y * y
    radial = _radial(camera, square)
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
        y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
    )


def _radial(camera: Camera, square: Array) -> Array:
    """Return the factor of radial distortion at squared radii: (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)."""
    k1, k2, _, _, k3, k4, k5, k6 = (*camera.distortion, *[0.0] * (8 - len(camera.distortion)))
    below = 1 + square * (k4 + square * (k5 + square * k6))
    return np.asarray(
        (1 + square * (k1 + square * (k2 + square * k3))) / np.where(below == 0, 1e-12, below), np.float64
    )


def fisheye_radius(camera: Camera, angle: Array) -> Array:
    """Return the distance from the image centre, in focal lengths, of angles (rad) from the axis: θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)."""
    k1, k2, k3, k4 = camera.distortion or (0.0, 0.0, 0.0, 0.0)
    square = angle * angle
    return np.asarray(angle * (1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))), np.float64)


def _first_fold(samples: Array, distorted: Callable[[Array], Array]) -> float:
    """Return the sample from which on `distorted` no longer grows, infinite where it always does."""
    falls = np.diff(distorted(samples)) <= 0
    return float(samples[int(falls.argmax())]) if falls.any() else math.inf
