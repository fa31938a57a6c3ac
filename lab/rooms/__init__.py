"""Procedural scenes with exact poses, for the demo, the tests and the benchmarks.

`build_scene` makes a scene from a specification; `scan_scene`, `take_panorama` and `take_photo` measure it; `change_scene` rearranges
it; `apply_look` changes light and camera; `suite_cases` yields the cases of the evaluation suites; `write_case` and
`write_case_folder` put them on disk.
"""

from lab.rooms.cameras import CAMERAS, QueryCamera
from lab.rooms.capture.camera_look import (
    DIM,
    GAMMA_3,
    LIGHT_CHANGES,
    PHOTO,
    WHITE_BALANCE,
    CameraLook,
    apply_look,
    random_look,
)
from lab.rooms.capture.change_truth import changed_pixels, changed_points
from lab.rooms.capture.cut_photo import cut_photo
from lab.rooms.capture.defective import with_any_defect
from lab.rooms.capture.free_space import RotationKind, random_rotation, sample_pose
from lab.rooms.capture.intruders import add_person, show_hand
from lab.rooms.capture.photo_camera import PhotoView, take_photo
from lab.rooms.capture.scanning import Scan, scan_scene, scan_with_truth
from lab.rooms.capture.spherical_camera import View, take_panorama, take_view
from lab.rooms.capture.tracking import session_axes, tracked
from lab.rooms.case_folder import PosedPanorama, write_case, write_case_folder
from lab.rooms.cases import Case, Suite, make_case
from lab.rooms.materials.labels import LABEL_COLORS
from lab.rooms.scenes.changes import change_scene
from lab.rooms.scenes.generator import FAMILIES, SceneKind, SceneSpec, build_scene
from lab.rooms.scenes.relighting import day, night, relit
from lab.rooms.scenes.scene import Scene
from lab.rooms.suites import suite_cases, suite_names, suite_of

__all__ = [
    "CAMERAS",
    "DIM",
    "FAMILIES",
    "GAMMA_3",
    "LABEL_COLORS",
    "LIGHT_CHANGES",
    "PHOTO",
    "WHITE_BALANCE",
    "CameraLook",
    "Case",
    "PhotoView",
    "PosedPanorama",
    "QueryCamera",
    "RotationKind",
    "Scan",
    "Scene",
    "SceneKind",
    "SceneSpec",
    "Suite",
    "View",
    "add_person",
    "apply_look",
    "build_scene",
    "change_scene",
    "changed_pixels",
    "changed_points",
    "cut_photo",
    "day",
    "make_case",
    "night",
    "random_look",
    "random_rotation",
    "relit",
    "sample_pose",
    "scan_scene",
    "scan_with_truth",
    "session_axes",
    "show_hand",
    "suite_cases",
    "suite_names",
    "suite_of",
    "take_panorama",
    "take_photo",
    "take_view",
    "tracked",
    "with_any_defect",
    "write_case",
    "write_case_folder",
]
