"""A small furnished room with a query of known pose, quick to register and to localize in."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from panoloc.core.geometry.pose import Pose, PoseError, pose_error
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.rooms import Scene, SceneSpec, build_scene, change_scene, sample_pose, scan_scene, take_panorama
from tests.core.image.picture_files import encoded

# A dozen starts suffice for a room of 12 m².
OPTIONS = '{"starts": {"method": "grid", "spacing_m": 1.0}}'


@dataclass(frozen=True)
class SmallRoom:
    """scan: PLY. panorama: JPEG. pose: the truth."""

    scan: bytes
    panorama: bytes
    pose: Pose

    def error_of(self, answer: dict[str, Any]) -> PoseError:
        """Return how far the pose in the answer is from the truth."""
        matrix = np.array(answer["pose"]["map_from_camera"]["matrix"])
        return pose_error(Pose(matrix[:3, :3], matrix[:3, 3]), self.pose)


@cache
def room_scene() -> Scene:
    """Build the scene once."""
    return build_scene(SceneSpec(kind="room", seed=5, area_m2=12))


@cache
def small_room() -> SmallRoom:
    """Build the room once."""
    scene = room_scene()
    pose = sample_pose(scene, np.random.default_rng(1))
    return SmallRoom(encode_ply(scan_scene(scene, num_points=20_000)), _panorama_from(pose), pose)


@cache
def _dense_cloud() -> PointCloud:
    return scan_scene(room_scene(), num_points=100_000)


def dense_scan() -> bytes:
    """Return a PLY of the room with as many points as surveyors have."""
    return encode_ply(_dense_cloud())


@dataclass(frozen=True)
class TwoStoreys:
    """The small room twice, one above the other. scan: PLY. height_m: of the upper floor above the lower one."""

    scan: bytes
    height_m: float


def two_storeys() -> TwoStoreys:
    """Scan the building."""
    cloud = _dense_cloud()
    height_m = float(np.ptp(cloud.positions[:, 2])) + 0.3
    above = cloud.positions + np.array([0, 0, height_m], cloud.positions.dtype)
    both = replace(cloud, positions=np.vstack((cloud.positions, above)), colors=np.vstack((cloud.colors,) * 2))
    return TwoStoreys(encode_ply(both), height_m)


@cache
def second_panorama() -> bytes:
    """Return a JPEG taken elsewhere in the room."""
    return _panorama_from(sample_pose(room_scene(), np.random.default_rng(2)))


@cache
def rearranged_panoramas() -> tuple[bytes, ...]:
    """Return JPEGs taken after most of the furniture was moved, taken away or exchanged."""
    scene = change_scene(room_scene(), seed=3)
    return tuple(_panorama_from(sample_pose(scene, np.random.default_rng(seed)), scene) for seed in (1, 2))


def fine_panorama() -> bytes:
    """Return the panorama of the small room with pixels half as large, for what is measured to a fraction of a degree."""
    return _panorama_from(small_room().pose, width=1024)


def _panorama_from(pose: Pose, scene: Scene | None = None, width: int = 512) -> bytes:
    return encoded(take_panorama(scene or room_scene(), pose, width).color, "JPEG", quality=92)
