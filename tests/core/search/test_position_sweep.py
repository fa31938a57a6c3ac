"""Candidates moved to where they fit best around their starts."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose
from panoloc.core.index.map_index import MapIndex
from panoloc.core.panorama.session import Session
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.pose_scores import Candidates
from panoloc.core.search.position_sweep import swept
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import SIDEWAYS, TWO, UPRIGHT, photo_of, session_of

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()
SEARCH = CONFIG.photo_search
POSE = Pose(rotation_of(130.0, 4.0, -3.0), np.array([1.7, 2.4, 1.5]))


def described(session: Session) -> DescribedPhotos:
    return PreparedPhotos(session, 512, None, torch.device("cpu"), CONFIG).described()


def found_at(starts: Tensor, rotations: Tensor) -> MapCandidates:
    """Return each start with the rotation of the same number, as a search would."""
    numbers = torch.arange(len(starts))
    return MapCandidates(Candidates(starts, numbers, torch.zeros(len(starts))), rotations, len(starts), len(starts))


def near_starts(index: MapIndex, place: Tensor, count: int) -> Tensor:
    return torch.cdist(index.starts, place[None])[:, 0].argsort()[:count]


@pytest.mark.parametrize("kind", ["photo", "frames"])
def test_a_candidate_moves_to_where_the_photo_was_taken(box: PaintedBox, box_index: MapIndex, kind: str) -> None:
    if kind == "photo":
        session, pose = Session.of_photo(photo_of(box, SIDEWAYS, POSE)), POSE
    else:  # each frame from a centre of its own
        session = session_of(box, Pose(rotation_of(40.0), np.array([0.4, -0.1, 1.2])), TWO, (UPRIGHT, SIDEWAYS))
        middle = np.mean([pose.position for pose in TWO], axis=0)
        pose = Pose(rotation_of(40.0), rotation_of(40.0) @ middle + np.array([0.4, -0.1, 1.2]))
    place = torch.tensor(pose.position - box_index.origin_offset).float()
    starts = near_starts(box_index, place, 4)
    rotation = torch.from_numpy(pose.rotation).float()
    search = replace(SEARCH, swept_distinct=replace(SEARCH.swept_distinct, distance_m=0.01))
    moved = swept(described(session), box_index, found_at(starts, rotation.expand(4, 3, 3)), search).candidates
    assert moved.places is not None
    before = (box_index.starts[starts] - place).norm(dim=-1).min()
    assert float((moved.places[0] - place).norm()) < min(0.15, float(before))
    assert (moved.scores.diff() <= 1e-6).all()


def test_what_is_near_a_better_one_is_left_out(box: PaintedBox, box_index: MapIndex) -> None:
    place = torch.tensor(POSE.position - box_index.origin_offset).float()
    starts = near_starts(box_index, place, 12)
    rotations = torch.from_numpy(POSE.rotation).float().expand(12, 3, 3)
    photos = described(Session.of_photo(photo_of(box, SIDEWAYS, POSE)))
    moved = swept(
        photos, box_index, found_at(starts, rotations), replace(SEARCH, swept_closer=0, fewest_swept_closer=0)
    )
    places = moved.candidates.places
    assert places is not None
    apart = torch.cdist(places, places) + 10 * torch.eye(len(places))
    assert float(apart.min()) >= SEARCH.swept_distinct.distance_m
    few = swept(photos, box_index, found_at(starts, rotations), replace(SEARCH, num_candidates=2))
    assert len(few.candidates) == 2


def test_nothing_found_is_nothing_moved(box: PaintedBox, box_index: MapIndex) -> None:
    none = torch.zeros(0, dtype=torch.long)
    found = found_at(none, torch.zeros((0, 3, 3)))
    photos = described(Session.of_photo(photo_of(box, SIDEWAYS, POSE)))
    assert swept(photos, box_index, found, SEARCH) is found
