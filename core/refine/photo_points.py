"""The points that candidates for photos are refined on: only those that the photos show, and a little around."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.features.equalization import apply_tables, equalization_tables
from panoloc.core.features.local_contrast import local_contrast
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.geometry.rotations import even_directions
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.map.map_index import MapIndex
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.refine.sphere_squares import patch_numbers
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.photo_comparison import RigView
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import RENDER_BATCH, halve, render_views

_FIRST_DIRECTIONS = 4096


@dataclass(frozen=True)
class LookDirections:
    """Directions (N, 3) in the axes of the rig that the photos show, or almost; inside: (N,), whether they do."""

    directions: Tensor
    inside: Tensor


def look_directions(atlas: PhotoAtlas, count: int, margin_deg: float) -> LookDirections:
    """Return directions spread evenly, `count` of them over what the photos show, as densely over a margin around it.

    The margin must be wider than a pose can turn: points that leave a photo lower the loss, and others must take their place.
    """
    margin = math.radians(margin_deg)
    device = atlas.rotations.device
    share = float(atlas.shows(even_directions(_FIRST_DIRECTIONS).to(device)).float().mean())
    every = even_directions(max(16, round(count / max(share, 1e-3)))).to(device)
    chosen = every[atlas.shows(every, margin)]
    return LookDirections(chosen, atlas.shows(chosen))


def _by_patch(look: LookDirections, side_deg: float | None) -> tuple[LookDirections, Tensor | None]:
    """Return the directions patch after patch, and the number of each one's patch; as they are without a size of patches."""
    if side_deg is None:
        return look, None
    patches, order = patch_numbers(look.directions, side_deg).sort(stable=True)
    return LookDirections(look.directions[order], look.inside[order]), patches


@dataclass(frozen=True)
class StartViews:
    """What starts see: point (T, P) int64, −1 for none; colors and contrast (T, P, 3) of views, and of their halves."""

    point: Tensor
    colors: tuple[Tensor, Tensor]
    contrast: tuple[Tensor, Tensor]
    height: int


def views_from_starts(index: MapIndex, starts: Tensor, height: int) -> StartViews:
    """Render the views of the starts numbered `starts` (T,)."""
    points: list[Tensor] = []
    parts: dict[str, list[Tensor]] = {"half": [], "full": [], "half contrast": [], "full contrast": []}
    for part in torch.split(starts, RENDER_BATCH):
        views = render_views(index.render_cloud, index.starts[part], height)
        points.append(views.point.flatten(1))
        contrast = views.color if index.labels is not None else local_contrast(views.color, views.valid.float())
        for name, values in (("", views.color), (" contrast", contrast)):
            parts["full" + name].append(values.flatten(1, 2))
            parts["half" + name].append(halve(values, views.valid).flatten(1, 2))
    joined = {name: torch.cat(values) for name, values in parts.items()}
    return StartViews(
        torch.cat(points), (joined["half"], joined["full"]), (joined["half contrast"], joined["full contrast"]), height
    )


def points_seen_in_starts(
    atlas: PhotoAtlas,
    cloud: RenderCloud,
    views: StartViews,
    rows: Tensor,
    rotations: Tensor,
    positions: Tensor,
    look: LookDirections,
    coarse: bool,
    contrast_share: float | None,
    patch_deg: float | None = None,
) -> CandidatePoints:
    """Return the points that K candidates should see, in the colours of the views `rows` (K,) of their starts.

    rotations (K, 3, 3) and positions (K, 3): of the rig. coarse: colours of half the views' rows. contrast_share: of contrast in the
    colours, which are equalized over what the photos show; None: label codes, as they are. patch_deg: to be aligned by patches so large.
    """
    look, patches = _by_patch(look, patch_deg)
    which, height = (0, views.height // 2) if coarse else (1, views.height)
    towards = torch.einsum("kab,nb->kna", rotations, look.directions)
    number = views.point[rows[:, None], pixels_towards(towards, views.height)]
    pixel = pixels_towards(towards, height)
    colors, weights = views.colors[which][rows[:, None], pixel], (number >= 0).float()
    if contrast_share is not None:
        colors = apply_tables(colors, equalization_tables(colors, weights * look.inside))
        colors = torch.lerp(colors, views.contrast[which][rows[:, None], pixel], contrast_share)
    points = cloud.positions[number.clamp_min(0)]
    return CandidatePoints(points, colors, weights, photos_showing(atlas, points, rotations, positions), patches)


def points_seen_by_photos(
    view: RigView,
    cloud: RenderCloud,
    comparison: Comparison,
    rotations: Tensor,
    positions: Tensor,
    look: LookDirections,
    contrast_share: float | None,
    pixel_weights: Tensor | None = None,
    patch_deg: float | None = None,
) -> CandidatePoints:
    """Return the points that photos show at K rendered poses of the rig, in the colours of the comparison.

    pixel_weights: (K, S), further weights of the rendered pixels. patch_deg: to be aligned by patches so large; None: point by point.
    """
    look, patches = _by_patch(look, patch_deg)
    window = comparison.views.window
    pixel, inside = window.pixels_towards(look.directions @ view.rig_from_view)
    number = comparison.views.point.flatten(1)[:, pixel]
    weights = ((number >= 0) & inside).float()
    if pixel_weights is not None:
        weights = weights * pixel_weights[:, pixel]
    colors = comparison.scan
    if contrast_share is not None:
        views = comparison.views
        # Of the surroundings only what the photos show too: at their edges both sides must know equally little. Points beyond
        # the edges keep their say, for those that leave a photo must be replaced.
        shown = comparison.weights > 0
        within = local_contrast(views.color, shown.view(views.valid.shape).float(), window).flatten(1, 2)
        beyond = local_contrast(views.color, views.valid.float(), window).flatten(1, 2)
        contrast = torch.where(shown[..., None], within, beyond)
        colors = torch.lerp(colors, contrast, contrast_share)
    colors = colors[:, pixel]
    points = cloud.positions[number.clamp_min(0)]
    return CandidatePoints(points, colors, weights, photos_showing(view.atlas, points, rotations, positions), patches)


def photos_showing(atlas: PhotoAtlas, points: Tensor, rotations: Tensor, positions: Tensor) -> Tensor | None:
    """Return the photo (K, N) whose middle is nearest to each point (K, N, 3), by angle over its opening; None of a single photo."""
    if len(atlas) == 1:
        return None
    in_rig = torch.einsum("kab,kna->knb", rotations, points - positions[:, None])
    best = torch.full(in_rig.shape[:2], torch.inf, device=points.device)
    chosen = torch.zeros(in_rig.shape[:2], dtype=torch.int64, device=points.device)
    for number in range(len(atlas)):
        moved = in_rig - atlas.centers[number]
        ahead = (moved @ atlas.rotations[number, :, 0]) / moved.norm(dim=-1).clamp_min(1e-6)
        off = torch.acos(ahead.clamp(-1, 1)) / atlas.cones[number]
        chosen = torch.where(off < best, number, chosen)
        best = torch.minimum(best, off)
    return chosen
