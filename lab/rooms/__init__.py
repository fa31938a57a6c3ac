"""Procedural scenes with exact poses, for the demo, the tests and the benchmarks.

`build_scene` makes a scene from a specification; `scan_scene`, `take_panorama` and `take_photo` measure it; `change_scene` rearranges
it; `apply_look` changes light and camera; `suite_cases` yields the cases of the evaluation suites; `write_case_folder` writes cases to
disk.
"""

from panoloc.lab.rooms.capture.camera_look import apply_look, random_look
from panoloc.lab.rooms.capture.change_truth import changed_pixels, changed_points
from panoloc.lab.rooms.capture.defects import with_any_defect
from panoloc.lab.rooms.capture.free_space import sample_pose
from panoloc.lab.rooms.capture.scanning import Scan, scan_scene, scan_with_truth
from panoloc.lab.rooms.capture.shooting import QueryCamera
from panoloc.lab.rooms.capture.views import View, cut_photo, take_panorama, take_photo, take_view
from panoloc.lab.rooms.case_folder import PosedPanorama, write_case_folder
from panoloc.lab.rooms.cases import Case, make_case
from panoloc.lab.rooms.scenes.changes import change_scene
from panoloc.lab.rooms.scenes.generator import FAMILIES, SceneSpec, build_scene
from panoloc.lab.rooms.scenes.scene import Scene
from panoloc.lab.rooms.suites import CAMERAS, suite_cases

__all__ = [
    "CAMERAS",
    "FAMILIES",
    "Case",
    "PosedPanorama",
    "QueryCamera",
    "Scan",
    "Scene",
    "SceneSpec",
    "View",
    "apply_look",
    "build_scene",
    "change_scene",
    "changed_pixels",
    "changed_points",
    "cut_photo",
    "make_case",
    "random_look",
    "sample_pose",
    "scan_scene",
    "scan_with_truth",
    "suite_cases",
    "take_panorama",
    "take_photo",
    "take_view",
    "with_any_defect",
    "write_case_folder",
]
