"""From pixels to viewing directions, for each camera model: the inverse of `panoloc.core.camera.lens`, in its convention."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import MAX_PINHOLE_RAD, Array, distort, fisheye_radius, fold_of, project_to_image

_MAX_STEPS = 20  # pixels that no direction reaches never converge
_CONVERGED = 1e-10  # focal lengths
_TOLERANCE_PX = 1e-3
_SAMPLES = 2048
_NUDGE = 1e-6  # focal lengths, of the differences that stand for derivatives


def directions_of(camera: Camera, u: Array, v: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return unit viewing directions (..., 3) of pixel coordinates u, v (...), and which of them (...) the lens shows at all.

    `project_to_image` gives the pixel of each direction that is shown; of the others the direction means nothing: they lie outside of
    the image, or in corners that no direction reaches.
    """
    across, down = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    inside = (u >= 0) & (u <= camera.width_px) & (v >= 0) & (v <= camera.height_px)
    if camera.model == "equirectangular":
        flat = np.cos(down)
        directions = np.stack((flat * np.cos(across), -flat * np.sin(across), -np.sin(down)), axis=-1)
        return directions, inside & (np.abs(across) <= math.pi) & (np.abs(down) <= math.pi / 2)
    if camera.model == "cylindrical":
        directions = np.stack((np.cos(across), -np.sin(across), -down), axis=-1)
        return _unit(directions), inside & (np.abs(across) <= math.pi)
    if camera.model == "opencv_fisheye":
        directions = _through_fisheye(camera, across, down)
    elif camera.distortion:
        x, y = _undistorted(camera, across, down)
        directions = _unit(np.stack((np.ones_like(x), -x, -y), axis=-1))
    else:
        directions = _unit(np.stack((np.ones_like(across), -across, -down), axis=-1))
        return directions, inside & (directions[..., 0] > math.cos(MAX_PINHOLE_RAD))
    again_u, again_v, shown = project_to_image(camera, directions)
    return directions, shown & (np.abs(again_u - u) < _TOLERANCE_PX) & (np.abs(again_v - v) < _TOLERANCE_PX)


def _unit(directions: Array) -> Array:
    return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))


def _through_fisheye(camera: Camera, across: Array, down: Array) -> Array:
    """Return directions of image coordinates in focal lengths: the angle whose distorted radius they have."""
    radius = np.hypot(across, down)
    angle = _inverse(
        radius, np.linspace(0, min(fold_of(camera), math.pi), _SAMPLES), lambda t: fisheye_radius(camera, t)
    )
    for _ in range(_MAX_STEPS):
        slope = (fisheye_radius(camera, angle + _NUDGE) - fisheye_radius(camera, angle - _NUDGE)) / (2 * _NUDGE)
        step = (fisheye_radius(camera, angle) - radius) / np.where(np.abs(slope) < 1e-9, 1.0, slope)
        angle = angle - step
        if np.abs(step).max(initial=0.0) < _CONVERGED:
            break
    off_axis = np.sin(angle) / np.maximum(radius, 1e-12)
    return np.stack((np.cos(angle), -across * off_axis, -down * off_axis), axis=-1)


def _undistorted(camera: Camera, across: Array, down: Array) -> tuple[Array, Array]:
    """Return where a plane one focal length away is hit (...), each, by Newton steps from the inverse along a line."""
    radius = np.hypot(across, down)
    samples = np.linspace(0, min(fold_of(camera), 12.0), _SAMPLES)
    start = _inverse(radius, samples, lambda r: distort(camera, r, np.zeros_like(r))[0])
    x, y = across * start / np.maximum(radius, 1e-12), down * start / np.maximum(radius, 1e-12)
    for _ in range(_MAX_STEPS):
        off_x, off_y = distort(camera, x, y)
        right_x, right_y = distort(camera, x + _NUDGE, y)
        below_x, below_y = distort(camera, x, y + _NUDGE)
        a, b = (right_x - off_x) / _NUDGE, (below_x - off_x) / _NUDGE
        c, d = (right_y - off_y) / _NUDGE, (below_y - off_y) / _NUDGE
        off_x, off_y = off_x - across, off_y - down
        determinant = a * d - b * c
        determinant = np.where(np.abs(determinant) < 1e-9, 1.0, determinant)
        step_x, step_y = (d * off_x - b * off_y) / determinant, (a * off_y - c * off_x) / determinant
        x, y = x - step_x, y - step_y
        if max(np.abs(step_x).max(initial=0.0), np.abs(step_y).max(initial=0.0)) < _CONVERGED:
            break
    return x, y


def _inverse(values: Array, samples: Array, function: Callable[[Array], Array]) -> Array:
    """Return about where a function that grows along `samples` has the given values."""
    return np.interp(values, function(samples), samples)
