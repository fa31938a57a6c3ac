"""The paper's maps of what changed, on their own: Eq. 2 and 3 with the paper's parameters, without the search for a pose."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from core.config import PaperConfig
from core.describe.patch_histograms import hard_histograms
from core.describe.spherical_patches import PatchGrid, rotation_table
from core.geometry.projection import pixel_solid_angles
from core.geometry.rotations import uniform_rotations
from core.index.map_index import MapIndex
from core.light.color_equalization import transport
from core.panorama.panorama import Panorama
from core.panorama.pyramid import PanoramaPyramid
from core.paper.intersection import bin_major, intersection_tensor
from core.paper.score_maps import score_map_2d, score_map_3d, view_patch_scores
from core.views.synthetic_view import render_views


@dataclass(frozen=True)
class PaperChangeMaps:
    """M_2D (rows, columns) by patch of the panorama and M_3D (N,) by point of the index, float32, larger = found in the other."""

    score_map_2d: NDArray[np.float32]
    point_scores: NDArray[np.float32]


@torch.inference_mode()
def paper_change_maps(panorama: Panorama, index: MapIndex, config: PaperConfig | None = None) -> PaperChangeMaps:
    """Return the paper's score maps of a panorama in a map of colours, with colours matched to the whole cloud (§3.1, §3.2)."""
    config, device = config or PaperConfig(), index.positions.device
    grid, height = PatchGrid(config.map_rows, config.map_columns), config.view_height
    colors = index.canonical_cloud_colors()
    level = PanoramaPyramid(panorama, config.image_height, None, device).level(config.image_height)
    weights = level.weights().flatten()
    matched = transport(level.color.flatten(1).T, weights, colors, torch.ones(len(colors), device=device))
    pixel_patch = grid.patch_of_pixel(level.height, 2 * level.height, device).flatten()[None]
    own = hard_histograms(matched[None], weights[None], pixel_patch, len(grid), config.bins)[0]

    count = min(config.num_starts, index.num_starts)
    starts = index.starts[torch.linspace(0, index.num_starts - 1, count, device=device).round().long()]
    cloud = index.render_cloud
    solid = pixel_solid_angles(height, 2 * height, device).expand(-1, 2 * height).flatten()
    view_patch = grid.patch_of_pixel(height, 2 * height, device).flatten()[None]
    histograms = []
    for start in starts:
        view = render_views(cloud, start[None], height)
        seen = view.valid.flatten(1) * solid
        histograms.append(hard_histograms(view.color.flatten(1, 2), seen, view_patch, len(grid), config.bins))
    tensor = intersection_tensor(own, bin_major(torch.cat(histograms)), count)
    table = rotation_table(grid, uniform_rotations(config.num_rotations).to(device))
    flat = score_map_2d(tensor, table).view(grid.rows, grid.columns)
    points = score_map_3d(view_patch_scores(tensor, table), index.positions, starts, grid)
    return PaperChangeMaps(flat.cpu().numpy(), points.cpu().numpy())
