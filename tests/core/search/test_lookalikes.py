"""The search for places that look like one that was found, in a painted box that looks the same after half a turn."""

import pytest
import torch

from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.index.map_index import MapIndex
from panoloc.core.panorama.session import Session
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.lookalikes import described_as_scanned, search_lookalikes
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.pose_limits import PoseLimits
from tests.core.built_maps import map_of
from tests.core.painted_box import PaintedBox
from tests.core.panorama.painted_photos import UPRIGHT, photo_of
from tests.core.search.symmetric_box import BOX, POSE, POSITION, ROTATION, TWIN

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()


@pytest.fixture(scope="module")
def index() -> MapIndex:
    return map_of(BOX)


def described(box: PaintedBox) -> DescribedPhotos:
    session = Session.of_photo(photo_of(box, UPRIGHT, POSE))
    return PreparedPhotos(session, 256, None, torch.device("cpu"), CONFIG).described()


@pytest.fixture(scope="module")
def as_scanned(index: MapIndex) -> DescribedPhotos:
    """Return what the photo of another room would show at the pose in this one."""
    return described_as_scanned(described(PaintedBox(seed=8)), index, ROTATION, POSITION, CONFIG)


def best_near(pose: Pose, found: MapCandidates, index: MapIndex) -> int | None:
    """Return the place of the first candidate that is at the start nearest to a pose, or almost, and turned as it is."""
    starts, turns = found.candidates.starts.tolist(), found.candidates.rotations.tolist()
    for rank, (start, turn) in enumerate(zip(starts, turns, strict=True)):
        candidate = Pose(found.rotations[turn].double().numpy(), index.starts[start].double().numpy())
        if pose_error(candidate, pose).within(0.6, 15.0):
            return rank
    return None


def test_what_is_described_is_the_scan_and_not_the_photo(as_scanned: DescribedPhotos) -> None:
    photo, stranger = described(BOX), described(PaintedBox(seed=8))
    scanned, own, other = as_scanned.pixels, photo.pixels, stranger.pixels
    both = own.solid > 0
    assert torch.equal(scanned.directions, other.directions)
    assert torch.equal(as_scanned.patches, stranger.patches)
    assert (scanned.colors - own.colors)[both].abs().mean() < 0.06 < (other.colors - own.colors)[both].abs().mean()


def test_both_sides_of_a_symmetric_room_are_found_first(as_scanned: DescribedPhotos, index: MapIndex) -> None:
    found = search_lookalikes(as_scanned, index, PoseLimits(), ROTATION, CONFIG)
    ranks = [best_near(pose, found, index) for pose in (POSE, TWIN)]
    assert None not in ranks
    assert max(rank for rank in ranks if rank is not None) < 4


def test_gravity_is_kept(as_scanned: DescribedPhotos, index: MapIndex) -> None:
    found = search_lookalikes(as_scanned, index, PoseLimits(), ROTATION, CONFIG)
    assert len(found.rotations) == CONFIG.photo_search.lookalike_turns
    torch.testing.assert_close(found.rotations[:, 2], ROTATION[2].expand(len(found.rotations), 3))
