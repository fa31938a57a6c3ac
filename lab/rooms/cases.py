"""One evaluation case from a recipe: a scan, a panorama, the pose, and what changed in between."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.photo_window import rig_on_sphere
from panoloc.core.options import ColorKind, Hints
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.rooms.capture.camera_look import PHOTO, CameraLook, apply_look, photo_with_look
from panoloc.lab.rooms.capture.change_truth import changed_pixels, changed_points
from panoloc.lab.rooms.capture.defects import with_any_defect
from panoloc.lab.rooms.capture.free_space import sample_pose
from panoloc.lab.rooms.capture.imperfect_scan import Imperfections, scan_imperfectly
from panoloc.lab.rooms.capture.intruders import add_person, show_hand
from panoloc.lab.rooms.capture.scanning import Scan, scan_with_truth
from panoloc.lab.rooms.capture.shooting import QueryCamera, Shooting
from panoloc.lab.rooms.capture.views import take_photo, take_view
from panoloc.lab.rooms.objects.solids import about_z
from panoloc.lab.rooms.scenes.changes import change_scene, day, night
from panoloc.lab.rooms.scenes.generator import SceneKind, SceneSpec, build_scene
from panoloc.lab.rooms.scenes.scene import Scene
from panoloc.lab.rooms.scenes.twin_scene import twin_poses

Region = tuple[tuple[float, float, float], tuple[float, float, float]]
_PERSON_SHARE = 0.3
_BESIDE_A_PERSON_M = 0.25


@dataclass(frozen=True, eq=False)
class Case:
    """One query with its truth.

    query: what was photographed. pose: map_from_camera of its first image, in the frame of the
    cloud. color_kind: "rgb" or "labels". changed_pixels: (H, W) bool, shows what was not scanned; None of photos. changed_points: (N,)
    bool, no longer there. region: corners (min, max) in metres that the camera is known to be in, None for no prior.
    alternatives: other poses that show the same picture, in places that exist twice. aliases: poses at which other rooms look most
    like it, and are not. hints: of the call. image_poses: map_from_camera of every photo. missing_pixels: (H, W) bool, drawn over,
    whether the mask says so or not; None where nothing is. map_from_session: without the noise of the tracking.
    """

    name: str
    cloud: PointCloud
    query: Rig
    pose: Pose
    color_kind: ColorKind
    changed_pixels: NDArray[np.bool_] | None
    changed_points: NDArray[np.bool_]
    seed: int
    region: Region | None = None
    alternatives: tuple[Pose, ...] = ()
    aliases: tuple[Pose, ...] = ()
    hints: Hints | None = None
    image_poses: tuple[Pose, ...] = ()
    missing_pixels: NDArray[np.bool_] | None = None
    map_from_session: Pose | None = None

    @cached_property
    def panorama(self) -> Panorama:
        """Return the query as one panorama: that of a rig from `rig_on_sphere`."""
        return rig_on_sphere(self.query)


@dataclass(frozen=True)
class Suite:
    """The recipe of a suite.

    change: share of the furniture that changes. look: a camera, or a function that draws one. at_night: photographed at night what
    was scanned by day. max_elevation_deg: half the height of the visible band in degrees, None for the full sphere.
    survey_frame: scan turned about z and given in large coordinates. imperfections: of the scan, None for an exact one.
    """

    kind: SceneKind = "room"
    change: float = 0.0
    look: CameraLook | Callable[[np.random.Generator], CameraLook] = PHOTO
    color_kind: ColorKind = "rgb"
    at_night: bool = False
    num_stations: int | None = None
    num_points: int = 300_000
    region: Region | None = None
    max_elevation_deg: float | None = None
    survey_frame: bool = False
    imperfections: Imperfections | None = None

    def drawn_look(self, rng: np.random.Generator) -> CameraLook:
        """Return the look of a query, drawn where the suite draws it."""
        return self.look if isinstance(self.look, CameraLook) else self.look(rng)


def make_case(
    name: str,
    suite: Suite,
    seed: int,
    families: Sequence[str] | None = None,
    width: int = 1024,
    camera: QueryCamera | None = None,
) -> Case:
    """Make one case of a suite; the same arguments always give the same case.

    camera: what takes photos in place of a full panorama. width: pixels of the panorama, or of a photo.
    """
    rng = np.random.default_rng((seed, 17))
    family = None if not families else families[int(rng.integers(len(families)))]
    scanned = build_scene(SceneSpec(suite.kind, seed, family))
    scan, as_scanned = _scan(suite, scanned, seed)
    now = change_scene(scanned, suite.change, seed) if suite.change > 0 else scanned
    now = night(now) if suite.at_night else now
    if camera is None or camera.shooting is None:
        taken = _panorama(suite, now, scanned, seed, width, rng)
    else:
        taken = _photos(suite, now, camera, camera.shooting, seed, width, rng)
    gone = changed_points(scan, as_scanned, taken.scene)
    others = twin_poses(scanned, taken.poses[0])
    # What changes in one room does not in the others.
    are_equal = scanned.twins is not None and scanned.twins.equal and suite.change == 0
    case = Case(
        name=f"{name}-{seed}",
        cloud=scan.cloud,
        query=taken.query,
        pose=taken.poses[0],
        color_kind=suite.color_kind,
        changed_pixels=taken.changed_pixels,
        changed_points=gone,
        seed=seed,
        region=suite.region,
        alternatives=others if are_equal else (),
        aliases=() if are_equal else others,
        hints=None if camera is None else camera.hints,
        image_poses=() if taken.map_from_session is None else taken.poses,
        map_from_session=taken.map_from_session,
    )
    if camera is not None and camera.shooting is None:
        case = _with_defect(case, masked=camera.masked)
    return _in_survey_frame(case, rng) if suite.survey_frame else case


def _scan(suite: Suite, scene: Scene, seed: int) -> tuple[Scan, Scene]:
    """Return the suite's scan and the scene as it was scanned: its light, and boxes for furniture."""
    stations, points, kind = suite.num_stations, suite.num_points, suite.color_kind
    if suite.imperfections is not None:
        imperfect = scan_imperfectly(scene, suite.imperfections, stations, points, seed, kind)
        return imperfect.scan, imperfect.scene
    scene = day(scene) if suite.at_night else scene
    return scan_with_truth(scene, stations, points, seed=seed, color_kind=kind), scene


@dataclass(frozen=True, eq=False)
class _Taken:
    """What was photographed: the scene with people who came into view, the query, map_from_camera of its images, and what of it is new."""

    scene: Scene
    query: Rig
    poses: tuple[Pose, ...]
    changed_pixels: NDArray[np.bool_] | None = None
    map_from_session: Pose | None = None


def _panorama(suite: Suite, now: Scene, scanned: Scene, seed: int, width: int, rng: np.random.Generator) -> _Taken:
    """Take a full panorama as the suite's camera shows it."""
    (pose,) = _among_twins(now, lambda: [sample_pose(now, rng)])
    if suite.change > 0 and rng.random() < _PERSON_SHARE:
        now = add_person(now, pose, seed)
    view = take_view(now, pose, width, suite.color_kind)
    new_pixels, panorama = changed_pixels(view, now, scanned), view.panorama
    if suite.color_kind == "rgb":
        if suite.change > 0:
            panorama, hand = show_hand(panorama, seed)
            new_pixels = new_pixels | hand
        panorama = apply_look(panorama, suite.drawn_look(rng), seed)
    if suite.max_elevation_deg is not None:
        panorama = _cropped(panorama, suite.max_elevation_deg)
    return _Taken(now, Rig.of_panorama(panorama), (pose,), new_pixels)


def _photos(
    suite: Suite, now: Scene, camera: QueryCamera, how: Shooting, seed: int, width: int, rng: np.random.Generator
) -> _Taken:
    """Take the photos of a session as the suite's light and look show them."""
    lens = how.camera(rng, width)
    poses = _among_twins(now, lambda: how.poses(now, rng))
    if suite.change > 0 and rng.random() < _PERSON_SHARE:
        with_person = add_person(now, poses[0], seed)
        # Nobody stands where the next picture is taken from.
        if with_person.surface.clearance(np.array([pose.position for pose in poses])).min() > _BESIDE_A_PERSON_M:
            now = with_person
    photos = [take_photo(now, lens, pose, suite.color_kind).photo for pose in poses]
    if suite.color_kind == "rgb":
        look = suite.drawn_look(rng)
        photos = [photo_with_look(photo, look, (seed, number)) for number, photo in enumerate(photos)]
    rig, axes = camera.rig_of(photos, poses, rng)
    return _Taken(now, rig, tuple(poses), None, axes)


def _with_defect(case: Case, *, masked: bool) -> Case:
    """Return the case of a panorama with one of all kinds of defects drawn over it."""
    panorama, missing = with_any_defect(case.panorama, np.random.default_rng((case.seed, 31)))
    shown = Panorama(panorama.color, panorama.valid & ~missing) if masked else panorama
    return replace(case, query=Rig.of_panorama(shown), missing_pixels=missing)


def _among_twins(scene: Scene, draw: Callable[[], list[Pose]]) -> list[Pose]:
    """Draw poses; where there are rooms that are alike, in one of them."""
    while True:
        poses = draw()
        if scene.twins is None or scene.twins.number_at(poses[0].position) is not None:
            return poses


def _in_survey_frame(case: Case, rng: np.random.Generator) -> Case:
    """Return the case with its scan turned about z, and in large coordinates like those of UTM."""
    yaw, offset = float(rng.uniform(-np.pi, np.pi)), rng.uniform((3e5, 5.2e6, 50.0), (6e5, 5.9e6, 600.0))
    turn = about_z(yaw)

    def moved(*poses: Pose) -> tuple[Pose, ...]:
        return tuple(Pose(turn @ pose.rotation, turn @ pose.position + offset) for pose in poses)

    positions = (case.cloud.positions.astype(np.float64) @ turn.T).astype(np.float32)
    return replace(
        case,
        cloud=replace(case.cloud, positions=positions, origin_offset=offset),
        pose=moved(case.pose)[0],
        alternatives=moved(*case.alternatives),
        aliases=moved(*case.aliases),
        image_poses=moved(*case.image_poses),
        map_from_session=None if case.map_from_session is None else moved(case.map_from_session)[0],
    )


def _cropped(panorama: Panorama, max_elevation_deg: float) -> Panorama:
    """Return the panorama with everything above and below a band around the horizon missing (black and masked)."""
    height = len(panorama.valid)
    elevation = 90 - 180 * (np.arange(height) + 0.5) / height
    valid = panorama.valid & (np.abs(elevation) <= max_elevation_deg)[:, None]
    return Panorama(panorama.color * valid[..., None], valid)
