"""What the search of each method computes, on random histograms of the shape that a room gives (about 12 of 512 bins in a patch)."""

from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from core.config import DescriptorConfig, PaperConfig, SearchConfig
from core.describe.patch_descriptors import (
    centered_roots,
    normalize_per_view,
    pooled,
    principal_basis,
    similarity_tensor,
)
from core.describe.spherical_patches import PatchGrid, rotation_table
from core.geometry.rotations import uniform_rotations
from core.paper.intersection import bin_major, intersection_tensor
from core.paper.score_maps import score_map_2d, view_patch_scores
from core.search.pose_scores import score_poses, select_candidates

CONFIG, DESCRIPTORS = SearchConfig(), DescriptorConfig()
GRID = PatchGrid(DESCRIPTORS.patch_rows, DESCRIPTORS.patch_columns)
OCCUPIED_BINS = 12
_ROOM_M = 6.0


class Search(Protocol):
    """One search over T starts and R rotations, everything of the map's side prepared as at registration."""

    table: Tensor

    def tensor(self) -> Tensor:
        """Return how alike each patch of the panorama and each patch of each view are."""

    def scores(self, tensor: Tensor) -> Tensor:
        """Return the scores of the best poses."""


def make_search(method: str, starts: int, num_rotations: int, device: torch.device) -> Search:
    """Return the search of `fast` or `paper`; the same arguments give the same histograms."""
    kind: type[FastSearch] | type[PaperSearch] = FastSearch if method == "fast" else PaperSearch
    return kind(np.random.default_rng(0), starts, uniform_rotations(num_rotations), device)


def score_maps(search: Search, tensor: Tensor) -> Tensor:
    """Compute both score maps of the search and return that of the scan's side."""
    score_map_2d(tensor, search.table)
    return view_patch_scores(tensor, search.table)


def random_histograms(rng: np.random.Generator, views: int) -> Tensor:
    """Return histograms (V, P, bins³) with about a dozen occupied bins each."""
    num_bins = DESCRIPTORS.bins**3
    histograms = np.zeros((views * len(GRID), num_bins), np.float32)
    bins = rng.integers(0, num_bins, (len(histograms), OCCUPIED_BINS))
    np.put_along_axis(histograms, bins, rng.dirichlet(np.ones(OCCUPIED_BINS), len(histograms)).astype(np.float32), 1)
    histograms /= histograms.sum(axis=1, keepdims=True)
    return torch.from_numpy(histograms.reshape(views, len(GRID), num_bins))


class FastSearch:
    """What `core.search.map_search` computes for one map, its first pass included."""

    def __init__(self, rng: np.random.Generator, starts: int, rotations: Tensor, device: torch.device) -> None:
        solid = GRID.solid_angles()
        parts = [random_histograms(rng, min(100, starts - first)) for first in range(0, starts, 100)]
        self.basis = principal_basis(
            centered_roots(parts[0], solid)[0], DESCRIPTORS.size, DESCRIPTORS.basis_patches
        ).to(device)
        centered = [centered_roots(part, solid) for part in parts]
        self.views = torch.cat([roots @ self.basis.cpu() for roots, _ in centered]).to(device)
        self.view_weights = torch.cat([weights for _, weights in centered]).to(device)
        query, weights = centered_roots(random_histograms(rng, 1), solid)
        self.query, self.weights = query[0].to(device), weights[0].to(device)
        self.rotations = rotations.to(device)
        self.table = rotation_table(GRID, rotations).to(device)
        self.positions = torch.rand((starts, 3), generator=torch.Generator().manual_seed(0)).to(device) * _ROOM_M
        self.coarse_views = pooled(self.views, self.view_weights)
        turns = uniform_rotations(CONFIG.coarse_rotations).to(device)
        self.coarse_table = rotation_table(PatchGrid(GRID.rows // 2, GRID.columns // 2), turns)
        self.kept = torch.arange(starts, device=device)

    def tensor(self) -> Tensor:
        """Discard starts in the first pass, and return normalized products of the descriptors of the others."""
        query = self.query @ self.basis
        count = max(CONFIG.coarse_kept_starts, round(CONFIG.coarse_kept_share * len(self.views)))
        views, weights = self.views, self.view_weights
        if count < len(views):
            coarse_query, coarse_weights = pooled(query[None], self.weights[None])
            products = similarity_tensor(coarse_query[0], self.coarse_views[0])
            alike = normalize_per_view(products, coarse_weights[0], self.coarse_views[1])
            self.kept = score_poses(alike, self.coarse_table, coarse_weights[0]).amax(1).topk(count).indices
            views, weights = views[self.kept], weights[self.kept]
        return normalize_per_view(similarity_tensor(query, views), self.weights, weights)

    def scores(self, tensor: Tensor) -> Tensor:
        """Score all poses and select distinct candidates."""
        scores = score_poses(tensor, self.table, self.weights)
        positions = self.positions[self.kept]
        return select_candidates(scores, positions, self.rotations, CONFIG).scores


class PaperSearch:
    """Histogram intersections, score maps and Eq. 4 on the search grid."""

    def __init__(self, rng: np.random.Generator, starts: int, rotations: Tensor, device: torch.device) -> None:
        parts = [random_histograms(rng, min(100, starts - first)) for first in range(0, starts, 100)]
        self.starts, self.views = starts, bin_major(torch.cat(parts)).to(device)
        self.query = random_histograms(rng, 1)[0].to(device)
        self.table = rotation_table(GRID, rotations).to(device)
        self.sines = GRID.polar_sines(device)

    def tensor(self) -> Tensor:
        """Return intersections of histograms."""
        return intersection_tensor(self.query, self.views, self.starts)

    def scores(self, tensor: Tensor) -> Tensor:
        """Score all poses and take the best."""
        weights = 0.5 * (score_map_2d(tensor, self.table) + self.sines)
        return score_poses(tensor, self.table, weights).flatten().topk(PaperConfig().num_candidates).values
