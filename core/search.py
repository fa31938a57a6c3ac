"""The search of the `fast` method: every start with every rotation, for every map.

One similarity tensor per map and query, of which pose scores are a weighted gather (docs/method.md).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from core.config import SearchConfig
from core.map_index import MapIndex
from core.panorama_pyramid import PanoramaPyramid
from core.patch_descriptors import centered_roots, normalize_per_view, similarity_tensor
from core.patch_histograms import soft_histograms
from core.pose_limits import PoseLimits
from core.pose_scores import Candidates, score_poses, select_candidates
from core.rotations import uniform_rotations
from core.spherical_patches import PatchGrid, rotation_table


@dataclass(frozen=True)
class RotationSet:
    """The rotations searched (R, 3, 3), map_from_camera, and which patches meet under each (R, P)."""

    rotations: Tensor
    table: Tensor

    def take(self, keep: Tensor) -> "RotationSet":
        """Return the rotations where `keep` (R,) is true."""
        return self if bool(keep.all()) else RotationSet(self.rotations[keep], self.table[keep])


def make_rotation_set(config: SearchConfig, device: torch.device) -> RotationSet:
    """Make the rotations of a configuration once; they do not depend on map or query."""
    rotations = uniform_rotations(config.num_rotations).to(device)
    return RotationSet(rotations, rotation_table(PatchGrid(config.patch_rows, config.patch_columns), rotations))


def describe_panorama(pyramid: PanoramaPyramid, index: MapIndex, config: SearchConfig) -> tuple[Tensor, Tensor]:
    """Return centred root histograms (P, bins³) of the panorama's patches and their weights (P,)."""
    level = pyramid.level(config.view_height)
    grid = PatchGrid(config.patch_rows, config.patch_columns)
    colors = level.canonical(index.labels).flatten(1).T[None]
    patch = grid.patch_of_pixel(level.height, 2 * level.height, colors.device).flatten()[None]
    histogram = soft_histograms(colors, level.weights().flatten()[None], patch, len(grid), config.bins)
    roots, weights = centered_roots(histogram, grid.solid_angles(colors.device))
    return roots[0], weights[0]


def search_map(
    pyramid: PanoramaPyramid, index: MapIndex, rotation_set: RotationSet, limits: PoseLimits, config: SearchConfig
) -> tuple[Candidates, RotationSet, int]:
    """Score all allowed poses of one map and choose candidates.

    Returns the candidates (starts numbered in the index, rotations in the returned set), that set, and how many starts were searched.
    """
    allowed_starts = limits.searched_starts(index.starts)
    allowed = rotation_set.take(limits.searched_rotations(rotation_set.rotations))
    numbers = allowed_starts.nonzero()[:, 0]
    if len(numbers) == 0 or len(allowed.rotations) == 0:
        empty = torch.zeros(0, dtype=torch.long, device=index.starts.device)
        return Candidates(empty, empty, empty.float()), allowed, 0
    roots, weights = describe_panorama(pyramid, index, config)
    views = index.descriptors
    values, view_weights = (
        (views.values, views.weights) if bool(allowed_starts.all()) else (views.values[numbers], views.weights[numbers])
    )
    tensor = similarity_tensor(roots @ views.basis, values)
    tensor = normalize_per_view(tensor, weights, view_weights)
    scores = score_poses(tensor, allowed.table, weights)
    chosen = select_candidates(
        scores,
        index.starts[numbers],
        allowed.rotations,
        config.num_candidates,
        config.distinct_angle_deg,
        config.distinct_distance_m,
    )
    return Candidates(numbers[chosen.starts], chosen.rotations, chosen.scores), allowed, len(numbers)
