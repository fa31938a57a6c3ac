"""Frames of a phone that is turned around in the small room, tracked as ARKit, ARCore and WebXR do: metres, y up."""

import io
import json
import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import take_panorama
from tests.integration.small_room import room_scene, small_room

_WIDTH, _HEIGHT, _HFOV_DEG = 480, 360, 100.0
_ARM_M = 0.1


@dataclass(frozen=True)
class TrackedFrames:
    """images: JPEG. session_from_camera: webxr poses (4, 4), y up. map_from_session: the truth (4, 4), both sides y up."""

    images: list[bytes]
    session_from_camera: list[NDArray[np.float64]]
    map_from_session: NDArray[np.float64]

    @property
    def options(self) -> str:
        """Return the options of the query."""
        focal_px = _WIDTH / 2 / math.tan(math.radians(_HFOV_DEG) / 2)
        lens = {"model": "pinhole", "width_px": _WIDTH, "height_px": _HEIGHT, "fx_px": focal_px}
        cameras = [{**lens, "session_from_camera": _as_sent(pose)} for pose in self.session_from_camera]
        return json.dumps({"frame": "webxr", "cameras": cameras, "session": {"up": "known"}})


@cache
def tracked_frames() -> TrackedFrames:
    """Take four frames at right angles, each a little away from the middle."""
    middle, images, poses = small_room().pose.position, [], []
    # Where the device began to track: turned by 40 degrees about the vertical, somewhere in the room.
    map_from_session = _y_up(Pose(_about_z(40.0), middle + np.array([0.4, -0.2, -1.1])))
    for number in range(4):
        turn = _about_z(25.0 + 90 * number)
        pose = Pose(turn, middle + _ARM_M * turn[:, 0])
        images.append(_photo(pose))
        poses.append(np.linalg.inv(map_from_session) @ pose.in_frame("webxr").matrix)
    return TrackedFrames(images, poses, map_from_session)


def _photo(pose: Pose) -> bytes:
    """Return what a pinhole at `pose` takes: pixels of a panorama along its rays."""
    panorama = take_panorama(room_scene(), pose, 1024)
    column, row = np.meshgrid(np.arange(_WIDTH) + 0.5, np.arange(_HEIGHT) + 0.5)
    focal_px = _WIDTH / 2 / math.tan(math.radians(_HFOV_DEG) / 2)
    left, up = (_WIDTH / 2 - column) / focal_px, (_HEIGHT / 2 - row) / focal_px
    c = (math.pi - np.arctan2(left, 1.0)) / (2 * math.pi) * 1024
    r = (math.pi / 2 - np.arctan2(up, np.hypot(left, 1.0))) / math.pi * 512
    buffer = io.BytesIO()
    Image.fromarray(panorama.color[r.astype(int), c.astype(int)]).save(buffer, "JPEG", quality=92)
    return buffer.getvalue()


def _about_z(degrees: float) -> NDArray[np.float64]:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def _y_up(between_worlds: Pose) -> NDArray[np.float64]:
    """Return a motion between worlds with z up (4, 4) as one between worlds with y up: (x, z, −y)."""
    axes = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    turned: NDArray[np.float64] = axes @ between_worlds.matrix @ axes.T
    return turned


def _as_sent(pose: NDArray[np.float64]) -> dict[str, Any]:
    known = Pose(pose[:3, :3], pose[:3, 3])
    return {
        "position_m": dict(zip("xyz", known.position.tolist(), strict=True)),
        "quaternion": dict(zip("xyzw", known.quaternion_xyzw.tolist(), strict=True)),
    }
