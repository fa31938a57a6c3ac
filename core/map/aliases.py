"""Perceptual aliasing: starts from which all of the scan looks as it does from another, found once, at registration.

All that a scan shows around a place is far more than a photo of it shows: from equal rooms it scores twice as much as from everywhere else
in a building (docs/experiments.md). Views are turned by whole columns of patches, which is a shift.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import DISTANCES, AliasConfig
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import rotation_from_vector

_STARTS_AT_ONCE = 64


@dataclass(frozen=True)
class Aliases:
    """Of each of T starts up to A others: starts (T, A) int32, −1 for none, and the turns (T, A) float32, radians, about the vertical that
    bring what is seen from the first onto what is seen from the other."""

    starts: Tensor
    turns: Tensor

    def to(self, device: torch.device | str) -> "Aliases":
        """Return them on `device`."""
        return Aliases(self.starts.to(device), self.turns.to(device))

    def take(self, keep: Tensor) -> "Aliases":
        """Return those of the starts numbered `keep`."""
        return Aliases(self.starts[keep], self.turns[keep])


def find_aliases(views: DescribedViews, starts: Tensor, config: AliasConfig) -> Aliases:
    """Return the aliases of all starts (T, 3), metres, of a map among themselves; no place is an alias of itself."""
    found = torch.full((len(starts), config.most), -1, dtype=torch.int32, device=starts.device)
    turns = torch.zeros((len(starts), config.most), device=starts.device)
    for part in torch.split(torch.arange(len(starts), device=starts.device), _STARTS_AT_ONCE):
        for number, scores in zip(part.tolist(), _scores(views, part, views), strict=True):
            angles = _angles(scores)
            is_near = (starts - starts[number]).norm(dim=1) < DISTANCES.elsewhere.distance_m
            is_level = torch.minimum(angles, 2 * math.pi - angles) < math.radians(DISTANCES.elsewhere.angle_deg)
            scores = scores.masked_fill(is_near[:, None] & is_level, -math.inf)
            others, angles = _best(scores, starts, config)
            found[number, : len(others)], turns[number, : len(others)] = others.int(), angles
    return Aliases(found, turns)


def aliases_in_another_map(
    own: DescribedViews, number: int, views: DescribedViews, starts: Tensor, config: AliasConfig
) -> tuple[Tensor, Tensor]:
    """Return the starts (A,) of those (T, 3) of a map from which it looks as another map does from its start `number`, best first, and
    the turns (A,) about the vertical that bring one onto the other; equal rooms stand upright."""
    return _best(_scores(own, torch.tensor([number], device=starts.device), views)[0], starts, config)


def _best(scores: Tensor, starts: Tensor, config: AliasConfig) -> tuple[Tensor, Tensor]:
    """Return the starts (A,) with the highest scores (T, K), and their turns (A,)."""
    best, turn = scores.max(1)
    kept = best.argsort(descending=True)[: int((best >= config.least).sum())]
    angles = _angles(scores)[turn[kept]]
    turned = rotation_from_vector(torch.nn.functional.pad(angles[:, None], (2, 0)))
    chosen = first_distinct(turned, starts[kept], DISTANCES.elsewhere, count=config.most)
    return kept[chosen], angles[chosen]


def _angles(scores: Tensor) -> Tensor:
    """Return the turns (K,), radians, of scores (T, K)."""
    return torch.arange(scores.shape[1], device=scores.device) * (2 * math.pi / scores.shape[1])


def _scores(own: DescribedViews, numbers: Tensor, views: DescribedViews) -> Tensor:
    """Return what `patch_scores` gives (N, T, K) for the patches of the views `numbers` (N,) of a map, turned K times about the vertical.

    The similarities of all pairs of patches, whose deviation is needed, follow from how the descriptors of both views spread.
    """
    described, others = own.descriptors(1), views.descriptors(1)
    values, weights = described.values[numbers], described.weights[numbers, :, None]
    if views is not own:
        values = values @ (own.basis.T @ views.basis)
    columns = own.grid.halved(1).columns
    weighted = (values * weights).view(len(numbers), -1, columns, values.shape[2])
    turned = torch.stack([weighted.roll(-turn, 2).flatten(1) for turn in range(columns)], 1)
    scores = others.values.flatten(1) @ turned.flatten(0, 1).T
    spread, spreads = (
        ((v * w).mT @ v).flatten(1) for v, w in ((values, weights), (others.values, others.weights[..., None]))
    )
    deviation = (spread @ spreads.T).sqrt().clamp_min(1e-9)
    return scores.view(len(others.values), len(numbers), columns).transpose(0, 1) / deviation[..., None]
