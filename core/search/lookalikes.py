"""The search for places that look like one that was found.

Of two equal rooms the search for a photo may propose poses in one alone: a photo shows the things and the light of its day, and a start
that happens to stand well wins. The scan as seen from the place that was found has neither, and finds the other room at once.
"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from panoloc.core.config import LocalizerConfig
from panoloc.core.features.fine_views import histograms_of_views, small_pictures
from panoloc.core.features.patch_descriptors import centered_roots
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.geometry.projection import project
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.map.map_index import MapIndex
from panoloc.core.render.described_view import views_to_describe
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.photo_search import search_rotations
from panoloc.core.search.pose_limits import PoseLimits


def described_as_scanned(
    photos: DescribedPhotos, index: MapIndex, rotation: Tensor, position: Tensor, config: LocalizerConfig
) -> DescribedPhotos:
    """Describe what photos would show of the scan alone at a pose of their rig, (3, 3) map_from_rig and (3,): in the same axes."""
    fine, device = config.fine_views, position.device
    grid, rows = PatchGrid(fine.patch_rows, fine.patch_columns), fine.picture_height
    is_labels = index.labels is not None
    view, _ = views_to_describe(index.render_cloud, position[None], config.descriptors.view_height, is_labels)
    histograms = histograms_of_views(view, grid, config.descriptors.bins, is_labels)
    roots, weights = centered_roots(histograms, grid.solid_angles(device))
    patches = grid.nearest_patch(grid.centers(device)[photos.patches] @ rotation.T)
    pictures, seen = small_pictures(view, rows)
    u, v = project(photos.pixels.directions @ rotation.T, rows, 2 * rows)
    at = v.long().clamp(0, rows - 1), u.long().clamp(0, 2 * rows - 1)
    return DescribedPhotos(
        roots[0, patches],
        photos.patches,
        photos.weights * (weights[0, patches] > 0),
        replace(photos.pixels, colors=pictures[0][at].float() / 255, solid=photos.pixels.solid * seen[0][at]),
    )


def search_lookalikes(
    as_scanned: DescribedPhotos, index: MapIndex, limits: PoseLimits, rotation: Tensor, config: LocalizerConfig
) -> MapCandidates:
    """Search a map for where the same is seen, with the rotation (3, 3) of the rig turned about the vertical: equal rooms stand upright.

    What looks far less like it than the best of them, which is the place itself as seen from a start beside it, is left out.
    """
    search = config.photo_search
    angles = torch.arange(search.lookalike_turns, device=rotation.device) * (2 * math.pi / search.lookalike_turns)
    about = torch.nn.functional.pad(angles[:, None], (2, 0))
    rotations = rotation_from_vector(about) @ rotation
    rotations = rotations[limits.allows_rotation(rotations, math.radians(search.limit_margin_deg))]
    rescored = min(search.lookalike_poses, search.lookalike_pixels // max(1, len(as_scanned.pixels)))
    # How alike places look is a share of the score by pixels alone.
    by_pixels = replace(search, histogram_weight=0.0)
    found = search_rotations(as_scanned, index, limits, rotations, rescored, by_pixels, config.fine_views)
    scores = found.candidates.scores
    kept = scores >= search.lookalike_least * (scores.max() if len(scores) else 0.0)
    return replace(found, candidates=found.candidates.take(kept))
