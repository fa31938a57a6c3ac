"""One evaluation case from a recipe: a scan, a panorama, the pose, and what changed in between."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.geometry.pose import Pose
from core.panorama.panorama import Panorama
from core.scan.point_cloud import PointCloud
from lab.rooms.capture.camera_look import PHOTO, CameraLook, apply_look
from lab.rooms.capture.change_truth import changed_pixels, changed_points
from lab.rooms.capture.free_space import RotationKind, sample_pose
from lab.rooms.capture.intruders import add_person, show_hand
from lab.rooms.capture.map_frame import survey_frame, turned_cloud, turned_pose
from lab.rooms.capture.scanning import scan_with_truth
from lab.rooms.capture.spherical_camera import take_view
from lab.rooms.scenes.changes import change_scene
from lab.rooms.scenes.generator import SceneKind, SceneSpec, build_scene
from lab.rooms.scenes.scene import Scene
from lab.rooms.scenes.twin_scene import twin_poses

Region = tuple[tuple[float, float, float], tuple[float, float, float]]
_PERSON_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class Case:
    """One query with its truth.

    pose: map_from_camera of the panorama, in the frame of the cloud. color_kind: "rgb" or "labels".
    changed_pixels: (H, W) bool, shows what was not scanned. changed_points: (N,) bool, no longer there.
    region: corners (min, max) in metres that the camera is known to be in, None for no prior.
    alternatives: other poses that show the same picture, in places that exist twice.
    """

    name: str
    cloud: PointCloud
    panorama: Panorama
    pose: Pose
    color_kind: str
    changed_pixels: NDArray[np.bool_]
    changed_points: NDArray[np.bool_]
    seed: int
    region: Region | None = None
    alternatives: tuple[Pose, ...] = ()


def as_built(scene: Scene) -> Scene:
    """Return the scene in the light it was built with."""
    return scene


@dataclass(frozen=True)
class Suite:
    """The recipe of a suite.

    change: share of the furniture that changes. look: a camera, or a function that draws one. scan_light, light: what
    makes day or night of the scene for the scan and for the photo. max_elevation_deg: half the height of the visible band
    in degrees, None for the full sphere. survey_frame: scan turned about z and given in large coordinates.
    """

    description: str
    kind: SceneKind = "room"
    change: float = 0.0
    look: CameraLook | Callable[[np.random.Generator], CameraLook] = PHOTO
    color_kind: str = "rgb"
    rotation: RotationKind = "any"
    scan_light: Callable[[Scene], Scene] = as_built
    light: Callable[[Scene], Scene] = as_built
    num_stations: int | None = None
    num_points: int = 300_000
    region: Region | None = None
    max_elevation_deg: float | None = None
    survey_frame: bool = False


def make_case(name: str, suite: Suite, seed: int, families: Sequence[str] | None = None, width: int = 1024) -> Case:
    """Make one case of a suite; the same arguments always give the same case."""
    rng = np.random.default_rng((seed, 17))
    family = None if not families else families[int(rng.integers(len(families)))]
    scanned = build_scene(SceneSpec(suite.kind, seed, family))
    in_scan_light = suite.scan_light(scanned)
    scan = scan_with_truth(in_scan_light, suite.num_stations, suite.num_points, seed=seed, color_kind=suite.color_kind)
    now = change_scene(scanned, suite.change, seed) if suite.change > 0 else scanned
    now = suite.light(now)
    pose = sample_pose(now, rng, suite.rotation)
    if suite.change > 0 and rng.random() < _PERSON_SHARE:
        now = add_person(now, pose, seed)
    panorama, new_pixels = _photograph(suite, now, scanned, pose, seed, width, rng)
    gone = changed_points(scan, scanned, now)
    cloud, others = scan.cloud, twin_poses(scanned, pose)
    if suite.survey_frame:
        yaw, offset = survey_frame(rng)
        cloud, pose = turned_cloud(cloud, yaw, offset), turned_pose(pose, yaw, offset)
        others = tuple(turned_pose(other, yaw, offset) for other in others)
    return Case(f"{name}-{seed}", cloud, panorama, pose, suite.color_kind, new_pixels, gone, seed, suite.region, others)


def _photograph(
    suite: Suite, now: Scene, scanned: Scene, pose: Pose, seed: int, width: int, rng: np.random.Generator
) -> tuple[Panorama, NDArray[np.bool_]]:
    """Return the panorama as the suite's camera shows it, and which pixels show what was not scanned."""
    view = take_view(now, pose, width, suite.color_kind)
    new_pixels, panorama = changed_pixels(view, now, scanned), view.panorama
    if suite.color_kind == "rgb":
        if suite.change > 0:
            panorama, hand = show_hand(panorama, seed)
            new_pixels = new_pixels | hand
        look = suite.look if isinstance(suite.look, CameraLook) else suite.look(rng)
        panorama = apply_look(panorama, look, seed)
    if suite.max_elevation_deg is not None:
        panorama = _cropped(panorama, suite.max_elevation_deg)
    return panorama, new_pixels


def _cropped(panorama: Panorama, max_elevation_deg: float) -> Panorama:
    """Return the panorama with everything above and below a band around the horizon missing (black and masked)."""
    height = len(panorama.valid)
    elevation = 90 - 180 * (np.arange(height) + 0.5) / height
    valid = panorama.valid & (np.abs(elevation) <= max_elevation_deg)[:, None]
    return Panorama(panorama.color * valid[..., None], valid)
