"""The points that candidates are aligned on: those that are seen where the images look, and a little around.

Points behind a wall must not vote: all of them come out of a z-buffer, first that of a start, later that of the pose itself.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.features.equalization import apply_tables, equalization_tables
from panoloc.core.features.local_contrast import local_contrast
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.geometry.rotations import even_directions
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.map.map_index import MapIndex
from panoloc.core.refine.patches import patch_numbers
from panoloc.core.refine.step import PointPlanes
from panoloc.core.render.comparison import Comparison, RigView
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import RENDER_BATCH, halve, render_views


@dataclass(frozen=True)
class LookDirections:
    """Directions (N, 3) in the axes of the rig that its images show, or almost, patch after patch.

    inside: (N,), whether they show them. patches: (N,) int64, the number of each one's patch.
    """

    directions: Tensor
    inside: Tensor
    patches: Tensor


def look_directions(pyramid: RigPyramid, count: int, margin_deg: float, patch_deg: float) -> LookDirections:
    """Return directions spread evenly, `count` of them over what the images show, as densely over a margin around it.

    The margin must be wider than a pose can turn: points that leave an image lower the loss, and others must take their place.
    """
    margin = math.radians(margin_deg)
    reach = pyramid.reach + margin
    around = even_directions(max(16, round(count / max(pyramid.share, 1e-3))), reach).to(pyramid.rotations.device)
    if reach < math.pi:
        # The third axis of the lattice becomes the optical axis of the first camera, which is the first of its axes.
        around = around @ pyramid.rotations[0].T.roll(-1, 0)
    directions = around[pyramid.shows(around, margin)]
    patches, order = patch_numbers(directions, patch_deg).sort(stable=True)
    directions = directions[order]
    return LookDirections(directions, pyramid.shows(directions), patches)


@dataclass(frozen=True)
class StartViews:
    """What starts see: point (T, P) int64, −1 for none; colours (T, P, 3) of their views, and of halves of these, and next to them local
    contrast, (T, P, 6), which label codes have none of.

    rows: of the views.
    """

    point: Tensor
    full: Tensor
    half: Tensor
    rows: int


def views_from_starts(index: MapIndex, starts: Tensor, rows: int) -> StartViews:
    """Render the views of the starts numbered `starts` (T,)."""
    points, full, half = [], [], []
    for part in torch.split(starts, RENDER_BATCH):
        views = render_views(index.render_cloud, index.starts[part], rows)
        points.append(views.point.flatten(1))
        shown = views.color
        if index.labels is None:
            shown = torch.cat((shown, local_contrast(views.color, views.valid.float())), dim=-1)
        full.append(shown.flatten(1, 2))
        half.append(halve(shown, views.valid).flatten(1, 2))
    return StartViews(torch.cat(points), torch.cat(full), torch.cat(half), rows)


def points_seen_from_starts(
    pyramid: RigPyramid,
    cloud: RenderCloud,
    views: StartViews,
    numbers: Tensor,
    rotations: Tensor,
    positions: Tensor,
    look: LookDirections,
    coarse: bool,
    contrast_share: float,
) -> PointPlanes:
    """Return the points that K candidates should see, in the colours of the views `numbers` (K,) of their starts.

    rotations (K, 3, 3) and positions (K, 3): of the rig. coarse: colours of half the views' rows. Colours are equalized over what the
    images show, and mixed with contrast.
    """
    shown, rows = (views.half, views.rows // 2) if coarse else (views.full, views.rows)
    towards = torch.einsum("kab,nb->kna", rotations, look.directions)
    point = views.point[numbers[:, None], pixels_towards(towards, views.rows)]
    pixel = pixels_towards(towards, rows)
    colors, weights = shown[..., :3][numbers[:, None], pixel], (point >= 0).float()
    if shown.shape[-1] > 3:
        colors = apply_tables(colors, equalization_tables(colors, weights * look.inside))
        colors = torch.lerp(colors, shown[..., 3:][numbers[:, None], pixel], contrast_share)
    seen = cloud.positions[point.clamp_min(0)]
    return PointPlanes.of_triples(
        seen, colors, weights, images_showing(pyramid, seen, rotations, positions), look.patches
    )


def points_seen_from_poses(
    view: RigView,
    cloud: RenderCloud,
    comparison: Comparison,
    rotations: Tensor,
    positions: Tensor,
    look: LookDirections,
    contrast_share: float,
) -> PointPlanes:
    """Return the points that images show at K rendered poses of the rig, in the colours of the comparison."""
    window = comparison.views.window
    pixel, inside = window.pixels_towards(look.directions @ view.rig_from_view)
    point = comparison.views.point.flatten(1)[:, pixel]
    weights = ((point >= 0) & inside).float()
    colors = comparison.scan
    if comparison.tables is not None:
        views = comparison.views
        # Of the surroundings only what the images show too: at their edges both sides must know equally little. Points beyond
        # the edges keep their say, for those that leave an image must be replaced.
        shown = comparison.weights > 0
        contrast = local_contrast(views.color, shown.view(views.valid.shape).float(), window).flatten(1, 2)
        if not window.is_whole:
            beyond = local_contrast(views.color, views.valid.float(), window).flatten(1, 2)
            contrast = torch.where(shown[..., None], contrast, beyond)
        colors = torch.lerp(colors, contrast, contrast_share)
    seen = cloud.positions[point.clamp_min(0)]
    found = images_showing(view.pyramid, seen, rotations, positions)
    return PointPlanes.of_triples(seen, colors[:, pixel], weights, found, look.patches)


def images_showing(pyramid: RigPyramid, points: Tensor, rotations: Tensor, positions: Tensor) -> Tensor | None:
    """Return the image (K, N) whose middle is nearest to each point (K, N, 3), by angle over its opening; None of a single image."""
    if len(pyramid) == 1:
        return None
    in_rig = torch.einsum("kab,kna->knb", rotations, points - positions[:, None])
    best = torch.full(in_rig.shape[:2], torch.inf, device=points.device)
    chosen = torch.zeros(in_rig.shape[:2], dtype=torch.int64, device=points.device)
    for number in range(len(pyramid)):
        moved = in_rig - pyramid.centers[number]
        ahead = (moved @ pyramid.rotations[number, :, 0]) / moved.norm(dim=-1).clamp_min(1e-6)
        off = torch.acos(ahead.clamp(-1, 1)) / pyramid.cones[number]
        chosen = torch.where(off < best, number, chosen)
        best = torch.minimum(best, off)
    return chosen
