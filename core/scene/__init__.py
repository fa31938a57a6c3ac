"""Procedural scenes with exact poses, for the demo, the tests and the benchmarks.

`build_scene` makes a scene from a specification; `scan_scene` and `take_panorama` measure it; `change_scene` rearranges it;
`apply_look` changes light and camera; `core.scene.suites` names the evaluation suites.
"""

from core.scene.change_truth import changed_pixels, changed_points
from core.scene.changes import change_scene
from core.scene.free_space import RotationKind, random_rotation, sample_pose
from core.scene.generator import FAMILIES, SceneKind, SceneSpec, build_scene
from core.scene.labels import LABEL_COLORS
from core.scene.scanning import Scan, scan_scene, scan_with_truth
from core.scene.scene import Scene
from core.scene.spherical_camera import View, take_panorama, take_view

__all__ = [
    "FAMILIES",
    "LABEL_COLORS",
    "RotationKind",
    "Scan",
    "Scene",
    "SceneKind",
    "SceneSpec",
    "View",
    "build_scene",
    "change_scene",
    "changed_pixels",
    "changed_points",
    "random_rotation",
    "sample_pose",
    "scan_scene",
    "scan_with_truth",
    "take_panorama",
    "take_view",
]
