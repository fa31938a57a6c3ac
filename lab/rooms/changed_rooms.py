"""A room that was scanned, changed and then photographed from several places, with the truth about what came and went."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.rooms.capture.camera_look import PHOTO, apply_look, random_look
from panoloc.lab.rooms.capture.change_truth import ChangedObject, changed_objects, changed_pixels
from panoloc.lab.rooms.capture.free_space import random_rotation, scanner_positions
from panoloc.lab.rooms.capture.imperfect_scan import Imperfections, scan_imperfectly
from panoloc.lab.rooms.capture.scanning import scan_with_truth
from panoloc.lab.rooms.capture.views import take_view
from panoloc.lab.rooms.scenes.changes import change_scene
from panoloc.lab.rooms.scenes.generator import SceneSpec, build_scene


@dataclass(frozen=True, eq=False)
class ChangedRoom:
    """panoramas, poses: map_from_camera, and changed_pixels (H, 2H) bool of each. objects: what came and went."""

    cloud: PointCloud
    panoramas: tuple[Panorama, ...]
    poses: tuple[Pose, ...]
    changed_pixels: tuple[NDArray[np.bool_], ...]
    objects: tuple[ChangedObject, ...]


def make_changed_room(
    seed: int,
    num_photos: int = 3,
    *,
    width: int = 1024,
    any_look: bool = False,
    imperfect: bool = False,
) -> ChangedRoom:
    """Make one room; the same arguments always give the same one.

    60 % of the furniture and pictures change, and all rugs go. any_look: every photo has a camera's look of its own. imperfect: the scan
    has the faults of a depth camera.
    """
    rng = np.random.default_rng((seed, 41))
    before = build_scene(SceneSpec("room", seed))
    if imperfect:
        scanned = scan_imperfectly(before, Imperfections(), seed=seed)
        scan, as_scanned = scanned.scan, scanned.scene
    else:
        scan, as_scanned = scan_with_truth(before, seed=seed), before
    now = change_scene(before, seed=seed)
    places = scanner_positions(now, num_photos, rng)
    poses = tuple(Pose(random_rotation(rng, "tilted"), place) for place in places)
    views = [take_view(now, pose, width) for pose in poses]
    looks = [random_look(rng) if any_look else PHOTO for _ in poses]
    photos = tuple(
        apply_look(view.panorama, look, 10 * seed + k) for k, (view, look) in enumerate(zip(views, looks, strict=True))
    )
    truth = tuple(changed_pixels(view, now, before) for view in views)
    return ChangedRoom(scan.cloud, photos, poses, truth, tuple(changed_objects(scan, as_scanned, now, poses)))
