"""The search for photos in a painted box: the right pose is among the candidates, within what hints and gravity allow."""

import math
from functools import cache

import numpy as np
import pytest
import torch

from panoloc.core.config import LocalizerConfig, PhotoSearchConfig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.index.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.panorama.session import Session, session_from_rig
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.photo_search import search_photos
from panoloc.core.search.pose_limits import PoseLimits, pose_limits
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import SIDEWAYS, TWO, UPRIGHT, photo_of, session_of

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()
POSE = Pose(rotation_of(130.0, 8.0, -5.0), np.array([1.7, 2.4, 1.5]))
MAP_FROM_SESSION = Pose(rotation_of(40.0), np.array([0.4, -0.1, 1.2]))


@cache
def one_photo() -> Session:
    return Session.of_photo(photo_of(PaintedBox(seed=3), SIDEWAYS, POSE))


@cache
def two_photos(up_known: bool = False) -> Session:
    return session_of(PaintedBox(seed=3), MAP_FROM_SESSION, TWO, (UPRIGHT, SIDEWAYS), up_known)


def rig_pose(session: Session, map_from_session: Pose) -> Pose:
    return map_from_session.after(session_from_rig(session))


def searched(
    session: Session, index: MapIndex, hints: Hints | None = None, config: PhotoSearchConfig = CONFIG.photo_search
) -> tuple[MapCandidates, PoseLimits]:
    photos = PreparedPhotos(session, 256, None, torch.device("cpu"), CONFIG)
    limits = photos.limits_of_rig(pose_limits(hints, index))
    (found,) = search_photos([photos.described()], [index], [limits], [None], config, CONFIG.fine_views)
    return found, limits


def rank_of(pose: Pose, found: MapCandidates, index: MapIndex, within: tuple[float, float] = (0.6, 15.0)) -> int | None:
    """Return the place of the first candidate near a pose of the rig."""
    starts, turns = found.candidates.starts.tolist(), found.candidates.rotations.tolist()
    for rank, (start, turn) in enumerate(zip(starts, turns, strict=True)):
        candidate = Pose(found.rotations[turn].double().numpy(), index.starts[start].double().numpy())
        if pose_error(candidate, pose).within(*within):
            return rank
    return None


@pytest.mark.parametrize("session", ["one photo", "two photos"])
def test_the_right_pose_is_among_the_first_candidates(session: str, box_index: MapIndex) -> None:
    photos, pose = (
        (one_photo(), POSE) if session == "one photo" else (two_photos(), rig_pose(two_photos(), MAP_FROM_SESSION))
    )
    found, _ = searched(photos, box_index)
    rank = rank_of(pose, found, box_index)
    assert rank is not None
    assert rank < 10
    scores = found.candidates.scores.tolist()
    assert scores == sorted(scores, reverse=True)
    assert 1 < len(scores) <= CONFIG.photo_search.num_candidates
    assert found.num_starts == box_index.num_starts
    assert found.num_poses == box_index.num_starts * CONFIG.photo_search.num_rotations


def test_with_up_known_fewer_rotations_are_searched_and_only_level_ones(box_index: MapIndex) -> None:
    freely, _ = searched(two_photos(), box_index)
    upright, _ = searched(two_photos(up_known=True), box_index)
    assert 0 < len(upright.rotations) < len(freely.rotations) / 10
    most = math.radians(5.0 + CONFIG.photo_search.limit_margin_deg)
    assert float(upright.rotations[:, 2, 2].min()) >= math.cos(most) - 1e-6
    rank = rank_of(rig_pose(two_photos(), MAP_FROM_SESSION), upright, box_index)
    assert rank is not None
    assert rank < 10


def test_hints_are_about_the_first_camera_also_when_it_stands_off_the_middle(box_index: MapIndex) -> None:
    first = MAP_FROM_SESSION.after(TWO[0])
    yaw = math.degrees(math.atan2(first.rotation[1, 0], first.rotation[0, 0]))
    x, y, z = first.position.tolist()
    hints = Hints(position_m=(x, y, z), radius_m=0.3, heading_deg=yaw, heading_tolerance_deg=10.0, upright=True)
    found, limits = searched(two_photos(), box_index, hints)
    truth = rig_pose(two_photos(), MAP_FROM_SESSION)
    assert limits.allows_pose(torch.from_numpy(truth.rotation).float(), torch.from_numpy(truth.position).float())
    assert rank_of(truth, found, box_index) is not None
    assert 0 < found.num_starts < box_index.num_starts
    margin = math.radians(CONFIG.photo_search.limit_margin_deg + 10.0) + 1e-4
    ahead = (found.rotations @ limits.first_rotation)[:, :, 0]  # type: ignore[operator]
    off = torch.atan2(ahead[:, 1], ahead[:, 0]) - math.radians(yaw)
    assert float(torch.atan2(off.sin(), off.cos()).abs().max()) <= margin
