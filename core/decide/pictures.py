"""Pictures for people: score maps, the scan beside the panorama, the scan from above. All are (H, W, 3) uint8 RGB.

Green means "as scanned", red "changed", grey "not scanned" or "not seen".
"""

import io
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions, project
from panoloc.core.map.map_index import MapIndex
from panoloc.core.render.render_cloud import counted_colors
from panoloc.core.render.synthetic_view import render_views
from panoloc.core.results import Localization
from panoloc.core.scan.from_above import Area, draw_from_above

Picture = NDArray[np.uint8]
_WIDTH = 1024
_KNOWN_SHARE = 0.3  # of the points in a pixel whose score is known, for the pixel to be tinted
_STOPS = np.array([[214, 47, 39], [253, 174, 97], [255, 255, 191], [102, 189, 99], [26, 152, 80]], dtype=np.float64)
_MISSING = np.array([60, 60, 66], dtype=np.float64)


def encode_png(picture: Picture) -> bytes:
    """Return a picture as the bytes of a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()


def draw_score_map_2d(panorama: Panorama, localization: Localization) -> Picture:
    """Tint the panorama by its score map; without a pose it stays as it is."""
    base = _shrunk(panorama)
    if localization.score_map_2d is None:
        return base
    scores = localization.score_map_2d
    rows = (np.arange(base.shape[0]) * scores.shape[0]) // base.shape[0]
    columns = (np.arange(base.shape[1]) * scores.shape[1]) // base.shape[1]
    return _tint(base, scores[rows][:, columns])


@dataclass(frozen=True)
class ScanView:
    """The scan as it looks from the found pose, in the panorama's own axes.

    picture: (H, W, 3) uint8. scores: (H, W) float of its points in 0..1, NaN where none is known.
    """

    picture: Picture
    scores: NDArray[np.float32]


def view_scan(index: MapIndex, localization: Localization, with_scores: bool = True) -> ScanView:
    """Render the scan at the found pose, once for all pictures that show it; without a pose all of it is missing."""
    if localization.best is None:
        nothing = np.full((_WIDTH // 2, _WIDTH), np.nan, np.float32)
        return ScanView(np.full((_WIDTH // 2, _WIDTH, 3), _MISSING.astype(np.uint8)), nothing)
    channels = [index.colors.float() / 255]
    if with_scores and localization.point_scores is not None:
        scores = torch.from_numpy(localization.point_scores).to(index.positions.device)
        # Scores travel through the renderer as further colours: the score where it is known, and whether it is.
        channels += [scores.nan_to_num(0.0)[:, None], (~scores.isnan()).float()[:, None]]
    color, valid = _render(index, localization.best.pose, torch.cat(channels, dim=1))
    missing = torch.from_numpy(_MISSING / 255).float().to(color.device)
    picture: Picture = (torch.where(valid[..., None], color[..., :3], missing) * 255).round().byte().cpu().numpy()
    if color.shape[-1] == 3:
        return ScanView(picture, np.full(picture.shape[:2], np.nan, np.float32))
    known = valid & (color[..., 4] > _KNOWN_SHARE)
    shown = torch.where(known, color[..., 3] / color[..., 4].clamp_min(1e-6), torch.nan)
    return ScanView(picture, shown.cpu().numpy())


def draw_score_map_3d(view: ScanView) -> Picture:
    """Tint the scan by the scores of its points."""
    return _tint(view.picture, view.scores)


def draw_overlay(panorama: Panorama, view: ScanView) -> Picture:
    """Put the panorama above the scan as it looks from the found pose, so that a person sees at once whether it is right."""
    top = _shrunk(panorama)
    line = np.full((4, top.shape[1], 3), 255, dtype=np.uint8)
    return np.vstack((top, line, view.picture))


def draw_map_preview(index: MapIndex, max_side: int = 900) -> Picture:
    """Draw the scan from above without what lies in the top 15 % (ceilings)."""
    positions, colors = index.positions.cpu().numpy(), index.colors.cpu().numpy()
    lower, upper = np.quantile(positions, 0.001, axis=0), np.quantile(positions, 0.999, axis=0)
    top_m = float(lower[2] + 0.85 * (upper[2] - lower[2]))
    return draw_from_above(positions, colors, Area(lower[:2], upper[:2], top_m), max_side).picture


def _shrunk(panorama: Panorama) -> Picture:
    shown = np.where(panorama.valid[..., None], panorama.color, _MISSING.astype(np.uint8))
    return np.asarray(Image.fromarray(shown).resize((_WIDTH, _WIDTH // 2), Image.Resampling.BILINEAR), dtype=np.uint8)


def _render(index: MapIndex, pose: Pose, colors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Render point colours (N, C) at a pose, turned into the camera's axes: (H, W, C) and which pixels are valid (H, W)."""
    height, width = _WIDTH // 2, _WIDTH
    device = index.positions.device
    position = torch.from_numpy(pose.position - index.origin_offset).float().to(device)
    cloud = replace(index.render_cloud, colors=counted_colors(colors))
    views = render_views(cloud, position[None], height, with_points=False)
    rotation = torch.from_numpy(pose.rotation).float().to(device)
    u, v = project(pixel_directions(height, width, device) @ rotation.T, height, width)
    row, column = v.long().clamp(0, height - 1), u.long().clamp(0, width - 1)
    return views.color[0, row, column], views.valid[0, row, column]


def _tint(base: Picture, scores: NDArray[np.floating]) -> Picture:
    """Mix a picture with the colours of its scores (H, W); NaN becomes grey."""
    grey = base.mean(axis=2, dtype=np.float32, keepdims=True)
    step = np.where(np.isnan(scores), _TINTS, np.clip(np.nan_to_num(scores), 0, 1) * (_TINTS - 1)).astype(np.int64)
    mixed: Picture = (0.225 * base + 0.225 * grey + _TINT_TABLE[step]).round().astype(np.uint8)
    return mixed


def _tint_table() -> NDArray[np.float32]:
    """Return the share of the colour in a tinted picture for `_TINTS` scores from 0 to 1, and last for a missing one."""
    at = np.linspace(0, 1, _TINTS)
    knots = np.linspace(0, 1, len(_STOPS))
    colors = np.stack([np.interp(at, knots, channel) for channel in _STOPS.T], axis=1)
    return (0.55 * np.vstack((colors, _MISSING))).astype(np.float32)


_TINTS = 256
_TINT_TABLE = _tint_table()
