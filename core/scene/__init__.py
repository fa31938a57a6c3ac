"""Procedural scenes with exact poses, for the demo, the tests and the benchmarks.

`build_scene` makes a scene from a specification; `scan_scene` and `take_panorama` measure it; `change_scene` rearranges
it; `apply_look` changes light and camera; `suite_cases` yields the cases of the evaluation suites; `write_case` and
`write_case_folder` put them on disk.
"""

from core.scene.camera_look import (
    DIM,
    GAMMA_3,
    LIGHT_CHANGES,
    PHOTO,
    WHITE_BALANCE,
    CameraLook,
    apply_look,
    random_look,
)
from core.scene.case_folder import Query, write_case, write_case_folder
from core.scene.cases import Case, Suite, make_case
from core.scene.change_truth import changed_pixels, changed_points
from core.scene.changes import change_scene
from core.scene.free_space import RotationKind, random_rotation, sample_pose
from core.scene.generator import FAMILIES, SceneKind, SceneSpec, build_scene
from core.scene.intruders import add_person, show_hand
from core.scene.labels import LABEL_COLORS
from core.scene.relighting import day, night, relit
from core.scene.scanning import Scan, scan_scene, scan_with_truth
from core.scene.scene import Scene
from core.scene.spherical_camera import View, take_panorama, take_view
from core.scene.suites import suite_cases, suite_names

__all__ = [
    "DIM",
    "FAMILIES",
    "GAMMA_3",
    "LABEL_COLORS",
    "LIGHT_CHANGES",
    "PHOTO",
    "WHITE_BALANCE",
    "CameraLook",
    "Case",
    "Query",
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
    "day",
    "make_case",
    "night",
    "random_look",
    "random_rotation",
    "relit",
    "sample_pose",
    "scan_scene",
    "scan_with_truth",
    "show_hand",
    "suite_cases",
    "suite_names",
    "take_panorama",
    "take_view",
    "write_case",
    "write_case_folder",
]
