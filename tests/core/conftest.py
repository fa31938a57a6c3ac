"""Maps and panoramas shared by the tests of the algorithm; the expensive ones are made once per session."""

import numpy as np
import pytest
import torch

from panoloc.core.geometry.pose import Pose
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.panorama.panorama import Panorama
from panoloc.core.results import Localization
from tests.core.built_maps import BOX, OTHER_BOX, map_of
from tests.core.painted_box import PaintedBox, rotation_of

torch.set_num_threads(1)  # the tests share their machine, and results do not depend on the number of cores


@pytest.fixture(scope="session")
def box() -> PaintedBox:
    return BOX


@pytest.fixture(scope="session")
def box_index() -> MapIndex:
    return map_of(BOX)


@pytest.fixture(scope="session")
def other_box_index() -> MapIndex:
    return map_of(OTHER_BOX)


@pytest.fixture(scope="session")
def box_pose() -> Pose:
    """Return a pose with a level-ish, slightly tilted camera off the middle of the box."""
    return Pose(rotation_of(130.0, 8.0, -5.0), np.array([1.7, 2.4, 1.5]))


@pytest.fixture(scope="session")
def box_panorama(box: PaintedBox, box_pose: Pose) -> Panorama:
    return box.panorama(box_pose)


@pytest.fixture(scope="session")
def localizer() -> Localizer:
    return Localizer(device="cpu")


@pytest.fixture(scope="session")
def answer(localizer: Localizer, box_index: MapIndex, box_panorama: Panorama) -> Localization:
    """Return the answer to the plain query in the box."""
    return localizer.localize(box_panorama, [box_index])
