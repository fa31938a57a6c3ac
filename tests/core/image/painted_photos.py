"""Photos of a painted box, alone and in rigs, made by the definition of a camera and not by the code under test."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Photo, Rig, RigImage
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import SessionOptions
from tests.core.built_maps import BOX, POSE
from tests.core.painted_box import PaintedBox, rotation_of

# A phone held upright, and one held sideways.
UPRIGHT = Camera.from_hfov("pinhole", 360, 480, 58.0)
SIDEWAYS = Camera.from_hfov("pinhole", 480, 360, 69.0)


def pinhole_rays(camera: Camera) -> NDArray[np.float64]:
    """Return the unit direction (H, W, 3) of each pixel of a pinhole."""
    column, row = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    left, up = (camera.cx_px - column) / camera.fx_px, (camera.cy_px - row) / camera.fy_px
    rays = np.stack((np.ones_like(left), left, up), axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def photo_of(camera: Camera, pose: Pose = POSE, box: PaintedBox = BOX) -> Photo:
    """Return what a pinhole at `pose` takes."""
    rays = pinhole_rays(camera).reshape(-1, 3) @ pose.rotation.T
    color = box.color_along(pose.position, rays).reshape(camera.height_px, camera.width_px, 3)
    return Photo(color, np.ones(color.shape[:2], bool), camera)


# Two and four places of a hand 0.4 m and more apart, in the axes of a session that begins somewhere else.
TWO = (
    Pose(rotation_of(10.0, 3.0), np.array([2.0, 1.0, 0.3])),
    Pose(rotation_of(75.0, -6.0, 4.0), np.array([2.1, 1.4, 0.3])),
)
FOUR = (
    *TWO,
    Pose(rotation_of(-65.0, 5.0), np.array([1.7, 1.2, 0.4])),
    Pose(rotation_of(170.0, -8.0, -3.0), np.array([1.8, 0.8, 0.2])),
)
MAP_FROM_SESSION = Pose(rotation_of(40.0), np.array([0.4, -0.1, 1.2]))


def session_of(poses: Sequence[Pose] = TWO, box: PaintedBox = BOX, up_known: bool = False) -> Rig:
    """Return photos of phones held upright and sideways in turn, taken at MAP_FROM_SESSION from poses known among each other."""
    images = [
        RigImage(photo_of(camera, MAP_FROM_SESSION.after(pose), box), pose)
        for camera, pose in zip((UPRIGHT, SIDEWAYS) * 2, poses, strict=False)
    ]
    return Rig(tuple(images), SessionOptions(up_known=up_known))


# Several modules look at it, and to paint it takes a tenth of a second.
OF_TWO = session_of(TWO)


def rig_pose(rig: Rig) -> Pose:
    """Return where in the map such a rig is."""
    return MAP_FROM_SESSION.after(rig.session_from_rig)
