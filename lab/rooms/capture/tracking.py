"""What a device's own tracking knows of its photos: poses among each other, in axes of its own, with noise."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.core.options import SessionOptions
from panoloc.core.panorama.session import Photo, Session, SessionImage
from panoloc.lab.rooms.capture.free_space import random_rotation

_ORIGIN_M = 3.0


def session_axes(rng: np.random.Generator, near: Pose, *, upright: bool) -> Pose:
    """Draw map_from_session: an origin within 3 m of a camera; any heading, with z up where `upright`, else any rotation."""
    rotation = random_rotation(rng, "upright" if upright else "any")
    return Pose(rotation, near.position + rng.uniform(-_ORIGIN_M, _ORIGIN_M, 3))


def tracked(
    photos: Sequence[Photo],
    poses: Sequence[Pose],
    map_from_session: Pose,
    options: SessionOptions,
    rng: np.random.Generator,
) -> Session:
    """Return the session of photos with map_from_camera `poses`, as tracking with the noise of `options` has it.

    The noise is normal and of its own in every image; its length and its angle are those of `options` in the quadratic mean.
    """
    session_from_map = map_from_session.inverse()
    images = tuple(
        SessionImage(photo, _shaken(session_from_map.after(pose), options, rng))
        for photo, pose in zip(photos, poses, strict=True)
    )
    return Session(images, options)


def _shaken(pose: Pose, options: SessionOptions, rng: np.random.Generator) -> Pose:
    per_axis = np.sqrt(1 / 3)
    shift = rng.normal(0, options.position_noise_m * per_axis, 3)
    turn = rng.normal(0, np.radians(options.orientation_noise_deg) * per_axis, 3)
    return Pose(_rotation_of(turn) @ pose.rotation, pose.position + shift)


def _rotation_of(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) about a vector (3,) by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
