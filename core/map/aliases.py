"""Perceptual aliasing: starts from which all of the scan looks as it does from another, found once, at registration.

All that a scan shows around a place is far more than a photo of it shows: from equal and repeated rooms it scores like the place itself
as seen from a start beside it, from everywhere else in a building half as much (docs/experiments.md).
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import AliasConfig
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.patch_descriptors import DescribedPatches, patch_scores
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import rotation_from_vector


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
    """Return the aliases of all starts (T, 3), metres, of a map among themselves."""
    found = torch.full((len(starts), config.most), -1, dtype=torch.int32, device=starts.device)
    turns = torch.zeros((len(starts), config.most), device=starts.device)
    for number in range(len(starts)):
        others, angles = aliases_of(views, starts, number, views, starts, config, is_same_map=True)
        found[number, : len(others)], turns[number, : len(others)] = others.int(), angles
    return Aliases(found, turns)


def aliases_of(
    own: DescribedViews,
    own_starts: Tensor,
    number: int,
    views: DescribedViews,
    starts: Tensor,
    config: AliasConfig,
    is_same_map: bool = False,
) -> tuple[Tensor, Tensor]:
    """Return the starts (A,) of a map from which it looks as another does from its start `number`, and the turns (A,) that bring one onto
    the other; equal rooms stand upright.

    own_starts: (S, 3), starts: (T, 3), metres. is_same_map: both are one map, in which no place is an alias of itself. Starts farther
    away than `distinct` say nothing of how a place looks from beside it.
    """
    angles = torch.arange(config.turns, device=starts.device) * (2 * math.pi / config.turns)
    is_turned = torch.minimum(angles, 2 * math.pi - angles) > math.radians(config.turned_deg)
    near = (own_starts - own_starts[number]).norm(dim=1) < config.elsewhere_m
    itself = near[:, None] & ~is_turned if is_same_map else torch.zeros((len(starts), len(angles)), dtype=torch.bool)
    beside = (own_starts - own_starts[number]).norm(dim=1) < config.distinct.distance_m
    beside[number] = False
    kept = torch.arange(len(starts), device=starts.device)
    for halvings, share in ((2, config.first_share), (1, config.share)):
        patches = own_patches(own, number, halvings, views)
        scores = _scores(patches, views, kept, angles, halvings)
        if bool(beside.any()):
            some = beside.nonzero()[:, 0]
            reference = float(
                _scores(own_patches(own, number, halvings, own), own, some, angles[~is_turned], halvings).max()
            )
        else:
            reference = math.inf  # starts are farther apart than that
        scores = scores.masked_fill(itself.to(scores.device)[kept], -math.inf)
        best, turn = scores.max(1)
        is_alike = best >= min(share * reference, config.least)
        kept, best, turn = kept[is_alike], best[is_alike], turn[is_alike]
        if not len(kept):
            return kept, angles[:0]
    order = best.argsort(descending=True)
    kept, turn = kept[order], turn[order]
    turned = rotation_from_vector(torch.nn.functional.pad(angles[turn][:, None], (2, 0)))
    chosen = torch.tensor(first_distinct(turned, starts[kept], config.distinct, count=config.most), device=kept.device)
    return kept[chosen], angles[turn[chosen]]


def own_patches(own: DescribedViews, number: int, halvings: int, views: DescribedViews) -> DescribedPatches:
    """Return what a map shows from one of its starts, along the basis of the views of another."""
    described = own.descriptors(halvings)
    values = described.values[number]
    if views is not own:
        values = values @ (own.basis.T @ views.basis)
    seen = described.weights[number].nonzero()[:, 0]
    return DescribedPatches(values[seen], seen, described.weights[number, seen], own.grid.halved(halvings))


def _scores(patches: DescribedPatches, views: DescribedViews, starts: Tensor, angles: Tensor, halvings: int) -> Tensor:
    turns = rotation_from_vector(torch.nn.functional.pad(angles[:, None], (2, 0)))
    return patch_scores(patches, views.descriptors(halvings).take(starts), turns)
