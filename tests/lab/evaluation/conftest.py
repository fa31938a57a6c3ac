"""A painted box as a case folder, for runs that have to be fast."""

from pathlib import Path

import numpy as np
import pytest
import torch

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import PosedPanorama, write_case_folder
from tests.core.conftest import box, box_index, box_pose
from tests.core.painted_box import PaintedBox, rotation_of

__all__ = ["box", "box_index", "box_pose"]

torch.set_num_threads(1)


@pytest.fixture(scope="session")
def box_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two boxes as cases, the first with two panoramas, the second with one."""
    root = tmp_path_factory.mktemp("cases")
    for name, seed, yaws in (("first", 3, (20.0, 130.0)), ("second", 44, (70.0,))):
        box = PaintedBox(seed=seed, size_m=(3.2, 3.0, 2.4))
        poses = [Pose(rotation_of(yaw, 3.0), np.array([1.4, 1.8, 1.3])) for yaw in yaws]
        queries = [
            PosedPanorama(f"q{k}", box.panorama(pose, 128), pose, ("box", f"q{k}")) for k, pose in enumerate(poses)
        ]
        write_case_folder(root / name, name, box.scan(6_000), queries)
    return root
