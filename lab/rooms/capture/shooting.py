"""How a query is photographed: with which camera, in which directions, from where, and what the device's tracking knows of it.

Headings, pitch and roll of a handheld camera are drawn here, and the places that its lens takes while it is turned or carried.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera, CameraModel
from panoloc.core.camera.rig import Photo, Rig, RigImage
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Hints, SessionOptions
from panoloc.lab.rooms.capture.free_space import free_position, random_rotation
from panoloc.lab.rooms.scenes.scene import Scene

_LEVEL_DEG = 5.0  # pitch and roll of a photo that is meant to be level
_TURN_JITTER_DEG = 5.0
_LENS_CLEARANCE_M = 0.2
_HEIGHT_JITTER_M = 0.03
_TRIES = 80
_ORIGIN_M = 3.0
_SHAPE = 0.75  # height of a pinhole's image in terms of its width


@dataclass(frozen=True)
class Shooting:
    """How the images of one query are taken.

    hfov_deg: least and greatest width of an image in degrees; a pinhole's is 4 : 3, a fisheye's square. vfov_deg: height of a cylinder,
    degrees. num_images: least and greatest. apart_deg: heading from one image to the next; None: looking around. arm_m: least and
    greatest distance of the lens from the axis that it is turned about. walk_m: length of the way on which the images are taken.
    pitch_deg, roll_deg: the largest.
    """

    model: CameraModel = "pinhole"
    hfov_deg: tuple[float, float] = (69.0, 69.0)
    vfov_deg: float = 50.0
    num_images: tuple[int, int] = (1, 1)
    apart_deg: float | None = 0.0
    arm_m: tuple[float, float] = (0.0, 0.0)
    walk_m: float = 0.0
    pitch_deg: float = _LEVEL_DEG
    roll_deg: float = _LEVEL_DEG

    def camera(self, rng: np.random.Generator, width: int) -> Camera:
        """Draw the camera of a query.

        width: pixels of a pinhole's image; a fisheye has three quarters of that, a full turn of a cylinder twice as many.
        """
        hfov = float(rng.uniform(*self.hfov_deg))
        if self.model == "cylindrical":
            rows = round(2 * width / np.pi * np.tan(np.radians(self.vfov_deg / 2)))
            return Camera.from_hfov(self.model, round(2 * width * hfov / 360), rows, hfov)
        if self.model == "opencv_fisheye":
            side = round(width * 0.75)
            return Camera.from_hfov(self.model, side, side, hfov)
        return Camera.from_hfov(self.model, width, round(width * _SHAPE), hfov)

    def rotations(self, rng: np.random.Generator) -> list[NDArray[np.float64]]:
        """Draw the orientation (3, 3) of each image in a level frame."""
        count = int(rng.integers(self.num_images[0], self.num_images[1] + 1))
        if self.apart_deg is None:  # looking left and right by 20 to 70 degrees from image to image
            steps = rng.uniform(20, 70, count) * rng.choice((-1, 1), count)
            headings = np.cumsum(steps)
        else:
            jitter = rng.uniform(-_TURN_JITTER_DEG, _TURN_JITTER_DEG, count) if count > 1 else np.zeros(1)
            headings = np.arange(count) * self.apart_deg + jitter
        headings += rng.uniform(-180, 180)
        pitch = rng.uniform(-self.pitch_deg, self.pitch_deg, count)
        roll = rng.uniform(-self.roll_deg, self.roll_deg, count)
        return [
            turned(float(a), float(b), float(c))
            for a, b, c in zip(np.radians(headings), np.radians(pitch), np.radians(roll), strict=True)
        ]

    def poses(self, scene: Scene, rng: np.random.Generator) -> list[Pose]:
        """Draw map_from_camera of each image: free of obstacles, and so is the way between them.

        Raises OptionsError where the scene has no such place.
        """
        for attempt in range(_TRIES):
            rotations = self.rotations(rng)
            stand = free_position(scene, rng)
            if len(rotations) == 1 and self.arm_m[1] == 0:
                return [Pose(rotations[0], stand)]
            # Small rooms leave less of a way.
            length = self.walk_m * 0.97 ** max(0, attempt - 20)
            centers = self._centers(stand, rotations, length, rng)
            if _is_free(scene, stand, centers):
                return [Pose(rotation, center) for rotation, center in zip(rotations, centers, strict=True)]
        raise OptionsError(
            "scene: expected room to turn or walk with a camera, found none; use fewer or smaller objects"
        )

    def _centers(
        self,
        stand: NDArray[np.float64],
        rotations: list[NDArray[np.float64]],
        length_m: float,
        rng: np.random.Generator,
    ) -> NDArray[np.float64]:
        """Return where the lens is (N, 3): at arm's length in front of a body that stands, or walks straight on."""
        count = len(rotations)
        looks = np.array([rotation[:, 0] * (1, 1, 0) for rotation in rotations])
        looks /= np.maximum(np.linalg.norm(looks, axis=1, keepdims=True), 1e-9)
        arm = rng.uniform(*self.arm_m) + rng.uniform(-0.04, 0.04, count)
        heading = rng.uniform(-np.pi, np.pi)
        along = np.linspace(0, length_m, count)[:, None] * np.array([np.cos(heading), np.sin(heading), 0])
        height = rng.uniform(-_HEIGHT_JITTER_M, _HEIGHT_JITTER_M, count)
        return np.asarray(stand + along + looks * arm.clip(*self.arm_m)[:, None] + np.outer(height, (0, 0, 1)))


def turned(yaw: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """Return the rotation Rz(yaw) Ry(pitch) Rx(roll) (3, 3), radians."""
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(angle), np.sin(angle)) for angle in (yaw, pitch, roll))
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1.0]])
    about_y = np.array([[cp, 0, sp], [0, 1.0, 0], [-sp, 0, cp]])
    about_x = np.array([[1.0, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(about_z @ about_y @ about_x)


def _is_free(scene: Scene, stand: NDArray[np.float64], centers: NDArray[np.float64]) -> bool:
    """Return whether the lens has room at every place (N, 3), and nothing stands between one and the next."""
    if scene.surface.clearance(centers).min() < _LENS_CLEARANCE_M:
        return False
    way = np.concatenate((stand[None], centers))
    return not scene.surface.blocked(way[:-1], way[1:]).any()


@dataclass(frozen=True)
class QueryCamera:
    """A way to photograph a query.

    shooting: how the images are taken; None: as a full panorama with a defect drawn over it. session: what is known of their poses among
    each other; None: of one image nothing, its own frame is the session. hints: of the call. masked: the mask
    covers the defect exactly. zoom: least and most, by which a focal length in EXIF data is too short.
    """

    shooting: Shooting | None
    session: SessionOptions | None = None
    hints: Hints | None = None
    masked: bool = False
    zoom: tuple[float, float] | None = None

    def rig_of(self, photos: Sequence[Photo], poses: Sequence[Pose], rng: np.random.Generator) -> tuple[Rig, Pose]:
        """Return what is known of photos with map_from_camera `poses`, and map_from_session without the noise of the tracking."""
        if self.session is not None:
            axes = session_axes(rng, poses[0], upright=self.session.up_known)
            return tracked(photos, poses, axes, self.session, rng), axes
        if self.zoom is None:
            return Rig.of_photo(photos[0]), poses[0]
        stated = Rig.of_photo(replace(photos[0], focal_uncertainty=0.013))
        return stated.with_focal_factor(math.exp(-rng.uniform(*np.log(self.zoom)))), poses[0]


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
) -> Rig:
    """Return the session of photos with map_from_camera `poses`, as tracking with the noise of `options` has it.

    The noise is normal and of its own in every image; its length and its angle are those of `options` in the quadratic mean.
    """
    session_from_map = map_from_session.inverse()
    images = tuple(
        RigImage(photo, _shaken(session_from_map.after(pose), options, rng))
        for photo, pose in zip(photos, poses, strict=True)
    )
    return Rig(images, options)


def _shaken(pose: Pose, options: SessionOptions, rng: np.random.Generator) -> Pose:
    per_axis = np.sqrt(1 / 3)
    shift = rng.normal(0, options.position_noise_m * per_axis, 3)
    turn = rng.normal(0, np.radians(options.orientation_noise_deg) * per_axis, 3)
    return Pose(rotation_of(turn) @ pose.rotation, pose.position + shift)


def rotation_of(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) about a vector (3,) by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
