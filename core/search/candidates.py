"""Poses that a search proposes in one map."""

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from panoloc.core.config import PoseDistance
from panoloc.core.geometry.distinct_poses import first_distinct


@dataclass(frozen=True)
class Candidates:
    """K poses, best first: starts (K,) that they were found at, rotations (K, 3, 3) map_from_rig, positions (K, 3) metres, scores (K,).

    by_patches: (K,), what histograms of patches add to the scores.
    """

    starts: Tensor
    rotations: Tensor
    positions: Tensor
    scores: Tensor
    by_patches: Tensor

    def __len__(self) -> int:
        return len(self.starts)

    def take(self, chosen: Tensor) -> "Candidates":
        """Return those that a mask (K,) or numbers choose."""
        return Candidates(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def first(self, count: int) -> "Candidates":
        """Return the first, at most `count`."""
        return Candidates(*(getattr(self, field.name)[:count] for field in fields(self)))

    def ranked(self, scores: Tensor, near: PoseDistance, count: int, pool: int) -> "Candidates":
        """Return the best of the first `pool` poses by other scores (K,), at most `count`, none near one before it."""
        order = scores.argsort(descending=True)[:pool]
        some = replace(self, scores=scores).take(order)
        chosen = first_distinct(some.rotations, some.positions, near, count=count)
        return some.take(torch.tensor(chosen, dtype=torch.long, device=order.device))


@dataclass(frozen=True)
class MapCandidates:
    """What the search found in one map. num_starts: that the hints left. num_poses: that were scored, in all passes."""

    candidates: Candidates
    num_starts: int
    num_poses: int
