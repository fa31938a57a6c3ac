"""Scores of poses: what is worked out for many at once against what each would have alone."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.config import DescriptorConfig
from panoloc.core.features.canonical import CanonicalColors
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.equalization import equalize
from panoloc.core.features.patch_descriptors import centered_roots, patch_scores
from panoloc.core.features.patch_histograms import PatchGrid, soft_histograms
from panoloc.core.geometry.rotations import uniform_rotations
from panoloc.core.image.label_codes import label_codes
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.search.described_rig import DescribedRig
from panoloc.core.search.map_search import patch_scores_of
from panoloc.core.search.pixel_scores import pixel_scores, scores_of_every_pose
from tests.core.built_maps import BOX, map_of
from tests.core.search.found_candidates import CONFIG, RIGS, query

pytestmark = pytest.mark.slow
SEARCH = CONFIG.search
ROTATIONS = uniform_rotations(60)
EVERY = torch.arange(40 * len(ROTATIONS))
EVERY_POSE = EVERY // len(ROTATIONS), EVERY % len(ROTATIONS)


@cache
def views() -> DescribedViews:
    """Return views of which some show nothing in places, as those of an open scan."""
    some = map_of(BOX).views.take(torch.arange(40))
    some.seen[::3, 10:20] = False
    return some


@pytest.fixture(params=["one photo", "two photos"])
def photos(request: pytest.FixtureRequest) -> DescribedRig:
    return query(request.param).rig.described


def test_all_at_once_is_what_each_would_have(photos: DescribedRig) -> None:
    """Of labels, which are not equalized pose by pose, the two are the same number."""
    pixels = replace(photos.pixels, is_labels=True)
    found = scores_of_every_pose(pixels, views(), ROTATIONS)
    expected = pixel_scores(pixels, views(), ROTATIONS, *EVERY_POSE)
    assert found.shape == (40, len(ROTATIONS))
    torch.testing.assert_close(found.flatten(), expected, atol=2e-4, rtol=0)


def test_one_table_for_the_map_ranks_nearly_as_one_for_each_pose(photos: DescribedRig) -> None:
    found = scores_of_every_pose(photos.pixels, views(), ROTATIONS).flatten()
    expected = pixel_scores(photos.pixels, views(), ROTATIONS, *EVERY_POSE)
    assert float(torch.corrcoef(torch.stack((found, expected)))[0, 1]) > 0.9


@pytest.mark.parametrize("name", RIGS)
def test_patches_of_some_poses_are_those_of_all(name: str) -> None:
    patches = query(name).rig.described.patches(views().basis)
    every = patch_scores(patches, views().descriptors(), ROTATIONS)
    start, rotation = torch.tensor([0, 3, 39, 3]), torch.tensor([5, 59, 0, 6])
    some = patch_scores_of(patches, views(), ROTATIONS, start, rotation)
    torch.testing.assert_close(some, every[start, rotation], atol=1e-5, rtol=1e-4)


# What images look like to the search.

GRID = PatchGrid(4, 8)
COARSE = DescriptorConfig(view_height=16, bins=4)


@pytest.mark.parametrize("labels", [False, True])
def test_a_panorama_is_described_as_the_views_of_a_map_are(labels: bool) -> None:
    rng = np.random.default_rng(0)
    palette = np.array([[0, 0, 0], [250, 20, 20], [20, 20, 250]], np.uint8)
    color = palette[rng.integers(0, 3, (64, 128))] if labels else rng.integers(0, 256, (64, 128, 3)).astype(np.uint8)
    valid = np.ones((64, 128), bool)
    valid[:16, :64] = False
    codes = label_codes(torch.from_numpy(np.repeat(palette, 50, 0))) if labels else None
    colors = CanonicalColors(RigPyramid(Rig.of_panorama(Panorama(color, valid)), 64, codes, "cpu"))
    described = DescribedRig(colors, COARSE)
    windows = colors.pyramid.windows(COARSE.view_height)
    (solid,) = windows.inside(windows.weights)
    patch, flat = GRID.patch_of_pixel(16, 32).flatten()[None], solid.flatten()[None]
    canonical = windows.inside(colors.equalized(windows))[0].flatten(1).T[None]
    contrast = equalize(windows.inside(colors.contrast(windows))[0].flatten(1).T[None], flat)
    shown = [canonical] if labels else [canonical, contrast]
    roots, weights = centered_roots(soft_histograms(shown, flat, patch, 32, COARSE.bins), GRID.solid_angles())
    found = described.patches(torch.eye(roots.shape[-1]))
    assert found.numbers.tolist() == list(range(4, 32))  # all but the masked ones
    torch.testing.assert_close(found.values, roots[0, 4:], atol=2e-4, rtol=1e-3)
    torch.testing.assert_close(found.weights, weights[0, 4:], atol=1e-3, rtol=0)
    # Four of them together are their mean.
    halved = described.patches(torch.eye(roots.shape[-1]), 1)
    last = [18, 19, 26, 27]
    mean = (weights[0, last, None] * roots[0, last]).sum(0) / weights[0, last].sum()
    at = halved.numbers.tolist().index(5)
    torch.testing.assert_close(halved.values[at], mean, atol=2e-4, rtol=1e-3)
    assert float(halved.weights[at]) == pytest.approx(float(weights[0, last].sum()), abs=1e-3)
