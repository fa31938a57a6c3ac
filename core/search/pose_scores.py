"""Scores of all poses, and the candidates chosen from them.

Paper: §3.1 (a rotated view takes the histograms of the nearest patches), §3.3, Eq. 4 (candidate selection).
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import SearchConfig
from panoloc.core.geometry.distinct_poses import first_distinct


@dataclass(frozen=True)
class Candidates:
    """Poses chosen for refinement: start numbers (K,), rotation numbers (K,), scores (K,), best first.

    by_patches: (K,), what histograms of patches add to the score of photos. places: (K, 3) metres, where the poses are; None: at starts.
    """

    starts: Tensor
    rotations: Tensor
    scores: Tensor
    by_patches: Tensor | None = None
    places: Tensor | None = None

    def __len__(self) -> int:
        return len(self.starts)

    def take(self, keep: Tensor) -> "Candidates":
        """Return those where `keep` (K,) is true."""
        by_patches = None if self.by_patches is None else self.by_patches[keep]
        places = None if self.places is None else self.places[keep]
        return Candidates(self.starts[keep], self.rotations[keep], self.scores[keep], by_patches, places)


def score_poses(tensor: Tensor, table: Tensor, weights: Tensor) -> Tensor:
    """Return w (T, R): for each start and rotation the weighted sum over query patches of I[t, i, π_r(i)].

    tensor: I (T, P, P), query patch first. table: π (R, P) from
    `panoloc.core.features.patch_grid.rotation_table`. weights: (P,).
    """
    num_views, num_patches, _ = tensor.shape
    rows = tensor.permute(1, 2, 0).reshape(-1, num_views)
    index = table + torch.arange(num_patches, device=table.device) * num_patches
    scores = torch.nn.functional.embedding_bag(
        index, rows, mode="sum", per_sample_weights=weights.expand(len(table), -1).contiguous()
    )
    return scores.T


def select_candidates(scores: Tensor, positions: Tensor, rotations: Tensor, config: SearchConfig) -> Candidates:
    """Choose the best poses that differ from each other.

    scores: (T, R), −inf where excluded; positions: (T, 3) metres; rotations: (R, 3, 3).
    """
    flat_scores, count = scores.flatten(), config.num_candidates
    for per_candidate in config.pools:
        top = flat_scores.topk(min(len(flat_scores), max(per_candidate * count, config.min_pool)))
        keep_finite = top.values > -math.inf
        values, flat = top.values[keep_finite], top.indices[keep_finite]
        start, rotation = flat // scores.shape[1], flat % scores.shape[1]
        chosen = first_distinct(rotations[rotation], positions[start], config.distinct, count=count)
        if len(chosen) == count:
            break
    pick = torch.tensor(chosen, dtype=torch.long, device=scores.device)
    return Candidates(start[pick], rotation[pick], values[pick])
