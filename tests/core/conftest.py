"""Boxes and maps as fixtures, for tests elsewhere; those of the algorithm call the functions themselves."""

import pytest
import torch

from panoloc.core.geometry.pose import Pose
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_index import MapIndex
from tests.core import built_maps
from tests.core.painted_box import PaintedBox

torch.set_num_threads(1)  # the tests share their machine, and results do not depend on the number of cores


@pytest.fixture(scope="session")
def box() -> PaintedBox:
    return built_maps.BOX


@pytest.fixture(scope="session")
def box_index() -> MapIndex:
    return built_maps.map_of(built_maps.BOX)


@pytest.fixture(scope="session")
def box_pose() -> Pose:
    return built_maps.POSE


@pytest.fixture(scope="session")
def localizer() -> Localizer:
    return built_maps.localizer()
