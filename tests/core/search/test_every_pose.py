"""The first look at every pose, against what is worked out pose by pose."""

import numpy as np
import pytest
import torch
from torch import Tensor

from panoloc.core.config import LocalizerConfig
from panoloc.core.describe.fine_views import FineViews
from panoloc.core.describe.spherical_patches import PatchGrid
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import uniform_rotations
from panoloc.core.index.map_index import MapIndex
from panoloc.core.panorama.session import Session
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.every_pose import scores_of_every_pose
from panoloc.core.search.patch_scores import patch_scores, patch_scores_of
from panoloc.core.search.pixel_scores import pixel_scores
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import SIDEWAYS, TWO, UPRIGHT, photo_of, session_of

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()
SEARCH = CONFIG.photo_search
POSE = Pose(rotation_of(130.0, 4.0, -3.0), np.array([1.7, 2.4, 1.5]))
ROTATIONS = uniform_rotations(60)


def described(session: Session) -> DescribedPhotos:
    return PreparedPhotos(session, 512, None, torch.device("cpu"), CONFIG).described()


@pytest.fixture(params=["photo", "frames"])
def photos(request: pytest.FixtureRequest, box: PaintedBox) -> DescribedPhotos:
    if request.param == "photo":
        return described(Session.of_photo(photo_of(box, SIDEWAYS, POSE)))
    where = Pose(rotation_of(40.0), np.array([0.4, -0.1, 1.2]))
    return described(session_of(box, where, TWO, (UPRIGHT, SIDEWAYS)))


@pytest.fixture
def views(box_index: MapIndex) -> FineViews:
    """Views of which some show nothing in places, as those of an open scan."""
    some = box_index.fine_views.take(torch.arange(40))
    some.seen[::3, 10:20] = False
    return some


def poses() -> tuple[Tensor, Tensor]:
    every = torch.arange(40 * len(ROTATIONS))
    return every // len(ROTATIONS), every % len(ROTATIONS)


def test_all_at_once_is_what_each_would_have(photos: DescribedPhotos, views: FineViews) -> None:
    """Of labels, which are not equalized pose by pose, the two are the same number."""
    found = scores_of_every_pose(photos.pixels, views, ROTATIONS, True, SEARCH)
    expected = pixel_scores(photos.pixels, views, ROTATIONS, *poses(), True, SEARCH)
    assert found.shape == (40, len(ROTATIONS))
    torch.testing.assert_close(found.flatten(), expected, atol=2e-4, rtol=0)


def test_one_table_for_the_map_ranks_nearly_as_one_for_each_pose(photos: DescribedPhotos, views: FineViews) -> None:
    found = scores_of_every_pose(photos.pixels, views, ROTATIONS, False, SEARCH).flatten()
    expected = pixel_scores(photos.pixels, views, ROTATIONS, *poses(), False, SEARCH)
    assert float(torch.corrcoef(torch.stack((found, expected)))[0, 1]) > 0.9


def test_patches_of_some_poses_are_those_of_all(photos: DescribedPhotos, views: FineViews) -> None:
    grid = PatchGrid(CONFIG.fine_views.patch_rows, CONFIG.fine_views.patch_columns)
    every = patch_scores(photos, views.descriptors(), ROTATIONS, grid)
    start, rotation = torch.tensor([0, 3, 39, 3]), torch.tensor([5, 59, 0, 6])
    some = patch_scores_of(photos, views, ROTATIONS, start, rotation, grid)
    torch.testing.assert_close(some, every[start, rotation], atol=1e-5, rtol=1e-4)
