"""Named evaluation suites: lists of cases with known poses, each made from a seed.

A suite is a recipe: what scene, how much of it changed since the scan, what light and camera, colors or labels.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.errors import OptionsError
from core.panorama import Panorama
from core.point_cloud import PointCloud
from core.pose import Pose
from core.scene.camera_look import DIM, GAMMA_3, PHOTO, WHITE_BALANCE, CameraLook, apply_look, as_photo, random_look
from core.scene.change_truth import changed_pixels, changed_points
from core.scene.changes import change_scene
from core.scene.free_space import RotationKind, sample_pose
from core.scene.generator import FAMILIES, SceneKind, SceneSpec, build_scene
from core.scene.intruders import add_person, show_hand
from core.scene.relighting import day, night
from core.scene.scanning import scan_with_truth
from core.scene.scene import Scene
from core.scene.spherical_camera import take_view

Region = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class Case:
    """One query with its truth.

    pose: map_from_camera of the panorama, in the frame of the cloud. color_kind: "rgb" or "labels".
    changed_pixels: (H, W) bool, shows what was not scanned. changed_points: (N,) bool, no longer there.
    region: corners (min, max) in metres that the camera is known to be in, None for no prior.
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


def as_built(scene: Scene) -> Scene:
    """Return the scene in the light it was built with."""
    return scene


@dataclass(frozen=True)
class Suite:
    """The recipe of a suite.

    change: share of the furniture that changes. look: a camera, or a function that draws one. scan_light, light: what
    makes day or night of the scene for the scan and for the photo.
    """

    description: str
    kind: SceneKind = "room"
    change: float = 0.0
    look: CameraLook | Callable[[np.random.Generator], CameraLook] = PHOTO
    color_kind: str = "rgb"
    rotation: RotationKind = "any"
    scan_light: Callable[[Scene], Scene] = as_built
    light: Callable[[Scene], Scene] = as_built
    num_points: int = 300_000
    region: Region | None = None


_PERSON_SHARE = 0.3
_STREET_REGION: Region = ((-25.0, -5.0, 0.0), (25.0, 5.0, 5.0))

SUITES: dict[str, Suite] = {
    "rooms": Suite("furnished rooms as scanned"),
    "changed": Suite(
        "60 % of the furniture moved, gone or new, carpets gone, a hand and perhaps a person in view", change=0.6
    ),
    "camera": Suite("60 % changed, another camera: exposure, balance, tone curve", change=0.6, look=random_look),
    "flats": Suite("flats of 4 to 6 rooms as scanned", kind="flat", num_points=500_000),
    "flats_changed": Suite("flats with 60 % changed", kind="flat", change=0.6, num_points=500_000),
    "bare": Suite("nearly empty rooms with few textures", kind="bare"),
    "dim": Suite("rooms at 67 % of the intensity", look=as_photo(DIM)),
    "gamma": Suite("rooms with gamma 3", look=as_photo(GAMMA_3)),
    "white_balance": Suite("rooms with white balance diag(1, 0.5, 0.5)", look=as_photo(WHITE_BALANCE)),
    "night": Suite("rooms scanned by daylight, photographed at night by lamps", scan_light=day, light=night),
    "labels": Suite("rooms as semantic labels", color_kind="labels"),
    "labels_changed": Suite("rooms as semantic labels, 60 % changed", change=0.6, color_kind="labels"),
    "street": Suite("a street as semantic labels", kind="street", color_kind="labels", region=_STREET_REGION),
    "street_colors": Suite("a street in colors", kind="street", region=_STREET_REGION),
}


def suite_names() -> tuple[str, ...]:
    """Return the names of all suites."""
    return tuple(SUITES)


def suite_cases(
    name: str, seeds: Sequence[int], *, families: Sequence[str] | None = None, width: int = 1024
) -> Iterator[Case]:
    """Yield one case per seed, made when asked for.

    families: style families to draw from, None for all; holding some out tests generalization. width: of the panorama.
    Raises OptionsError for an unknown suite or family.
    """
    if name not in SUITES:
        raise OptionsError(f"suite: expected one of {', '.join(SUITES)}, got {name!r}")
    unknown = set(families or ()) - set(FAMILIES)
    if unknown:
        raise OptionsError(f"families: expected some of {', '.join(FAMILIES)}, got {', '.join(sorted(unknown))}")
    return (make_case(name, SUITES[name], seed, families, width) for seed in seeds)


def make_case(name: str, suite: Suite, seed: int, families: Sequence[str] | None = None, width: int = 1024) -> Case:
    """Make one case of a suite."""
    rng = np.random.default_rng((seed, 17))
    family = None if not families else families[int(rng.integers(len(families)))]
    scanned = build_scene(SceneSpec(suite.kind, seed, family))
    scan = scan_with_truth(
        suite.scan_light(scanned), num_points=suite.num_points, seed=seed, color_kind=suite.color_kind
    )
    now = change_scene(scanned, suite.change, seed) if suite.change > 0 else scanned
    now = suite.light(now)
    pose = sample_pose(now, rng, suite.rotation)
    if suite.change > 0 and rng.random() < _PERSON_SHARE:
        now = add_person(now, pose, seed)
    view = take_view(now, pose, width, suite.color_kind)
    new_pixels, panorama = changed_pixels(view, now, scanned), view.panorama
    if suite.color_kind == "rgb":
        if suite.change > 0:
            panorama, hand = show_hand(panorama, seed)
            new_pixels = new_pixels | hand
        look = suite.look if isinstance(suite.look, CameraLook) else suite.look(rng)
        panorama = apply_look(panorama, look, seed)
    gone = changed_points(scan, scanned, now)
    return Case(f"{name}-{seed}", scan.cloud, panorama, pose, suite.color_kind, new_pixels, gone, seed, suite.region)
