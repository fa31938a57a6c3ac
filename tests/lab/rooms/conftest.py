"""One small furnished room, its changed form, and a scan, shared by the tests of the generator."""

import numpy as np
import pytest

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import (
    Scan,
    Scene,
    SceneSpec,
    View,
    build_scene,
    change_scene,
    sample_pose,
    scan_with_truth,
    take_view,
)


@pytest.fixture(scope="session")
def room() -> Scene:
    return build_scene(SceneSpec("room", seed=4, area_m2=14.0))


@pytest.fixture(scope="session")
def flat() -> Scene:
    return build_scene(SceneSpec("flat", seed=2))


@pytest.fixture(scope="session")
def changed_room(room: Scene) -> Scene:
    return change_scene(room, 0.6, seed=1)


@pytest.fixture(scope="session")
def room_scan(room: Scene) -> Scan:
    return scan_with_truth(room, num_points=40_000, noise_m=0.004)


@pytest.fixture(scope="session")
def pose(changed_room: Scene) -> Pose:
    return sample_pose(changed_room, np.random.default_rng(5), "any")


@pytest.fixture(scope="session")
def room_view(room: Scene, pose: Pose) -> View:
    return take_view(room, pose, width=512)
