"""The closer look around a place, in a painted box."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.geometry.rotations import rotation_angle
from panoloc.core.index.map_index import MapIndex
from panoloc.core.panorama.session import Session
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.search.closer_look import search_around
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.pose_limits import PoseLimits
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import UPRIGHT, photo_of

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()
SEARCH = CONFIG.photo_search
POSE = Pose(rotation_of(130.0, 4.0, -3.0), np.array([1.7, 2.4, 1.5]))
# Where somebody might think that it is.
NEAR = Pose(rotation_of(112.0, 0.0, 0.0), np.array([2.2, 2.1, 1.5]))


@pytest.fixture(scope="module")
def photos(box: PaintedBox) -> DescribedPhotos:
    session = Session.of_photo(photo_of(box, UPRIGHT, POSE))
    return PreparedPhotos(session, 256, None, torch.device("cpu"), CONFIG).described()


def found_near(photos: DescribedPhotos, index: MapIndex, pose: Pose, limits: PoseLimits) -> MapCandidates:
    position = torch.from_numpy(pose.position - index.origin_offset).float()
    return search_around(photos, index, limits, None, torch.from_numpy(pose.rotation).float(), position, CONFIG)


def poses_of(found: MapCandidates, index: MapIndex) -> tuple[Tensor, Tensor]:
    """Return rotations (K, 3, 3) and positions (K, 3), in the axes of the index."""
    return found.rotations[found.candidates.rotations], index.starts[found.candidates.starts]


def test_the_right_pose_is_among_the_best_candidates(photos: DescribedPhotos, box_index: MapIndex) -> None:
    rotations, positions = poses_of(found_near(photos, box_index, NEAR, PoseLimits()), box_index)
    poses = [
        Pose(r.double().numpy(), p.double().numpy() + box_index.origin_offset)
        for r, p in zip(rotations, positions, strict=True)
    ]
    assert any(pose_error(pose, POSE).within(0.6, 12.0) for pose in poses[:3])


def test_nothing_else_is_proposed_than_what_is_near(photos: DescribedPhotos, box_index: MapIndex) -> None:
    found = found_near(photos, box_index, NEAR, PoseLimits())
    rotations, positions = poses_of(found, box_index)
    away = (positions.double().numpy() + box_index.origin_offset) - NEAR.position
    assert 4 < len(found.candidates) <= SEARCH.closer_candidates
    assert np.linalg.norm(away, axis=1).max() <= SEARCH.closer_m + SEARCH.limit_margin_m + 1e-5
    assert float(rotation_angle(rotations, torch.from_numpy(NEAR.rotation).float()).max()) <= math.radians(
        SEARCH.closer_deg
    )
