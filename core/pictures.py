"""Pictures for people: score maps, the scan beside the panorama, the scan from above. All are (H, W, 3) uint8 RGB.

Green means "as scanned", red "changed", grey "not scanned" or "not seen".
"""

import io
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from core.map_index import MapIndex
from core.panorama import Panorama
from core.pose import Pose
from core.projection import pixel_directions, project
from core.results import Localization
from core.synthetic_view import counted_colors, render_views

Picture = NDArray[np.uint8]
_WIDTH = 1024
_STOPS = np.array([[214, 47, 39], [253, 174, 97], [255, 255, 191], [102, 189, 99], [26, 152, 80]], dtype=np.float64)
_MISSING = np.array([60, 60, 66], dtype=np.float64)


def encode_png(picture: Picture) -> bytes:
    """Return a picture as the bytes of a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG", compress_level=3)
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


def draw_score_map_3d(index: MapIndex, localization: Localization) -> Picture:
    """Render the scan at the found pose, tinted by the scores of its points, in the panorama's own axes."""
    if localization.best is None:
        return np.full((_WIDTH // 2, _WIDTH, 3), _MISSING.astype(np.uint8))
    pose = localization.best.pose
    if localization.point_scores is None:
        return _render(index, pose, index.colors.float() / 255)
    scores = torch.from_numpy(localization.point_scores).to(index.positions.device)
    base = _render(index, pose, index.colors.float() / 255)
    # Scores travel through the renderer as a colour: score, known, and nothing.
    known = ~scores.isnan()
    channels = torch.stack((scores.nan_to_num(0.0), known.float(), torch.zeros_like(scores)), dim=-1)
    rendered = _render(index, pose, channels).astype(np.float64) / 255
    with np.errstate(invalid="ignore", divide="ignore"):
        shown = np.where(rendered[..., 1] > 0.3, rendered[..., 0] / rendered[..., 1], np.nan)
    return _tint(base, shown)


def draw_overlay(panorama: Panorama, index: MapIndex, localization: Localization) -> Picture:
    """Put the panorama above the scan rendered at the found pose, so that a person sees at once whether it is right."""
    top = _shrunk(panorama)
    if localization.best is None:
        return top
    bottom = _render(index, localization.best.pose, index.colors.float() / 255)
    line = np.full((4, top.shape[1], 3), 255, dtype=np.uint8)
    return np.vstack((top, line, np.asarray(Image.fromarray(bottom).resize((top.shape[1], top.shape[0])))))


def draw_map_preview(index: MapIndex, max_side: int = 900) -> Picture:
    """Draw the scan from above without what lies in the top 15 % (ceilings), with a dot at every start."""
    positions, colors = index.positions.cpu().numpy(), index.colors.cpu().numpy()
    lower, upper = np.quantile(positions, 0.001, axis=0), np.quantile(positions, 0.999, axis=0)
    # Half the size, enlarged afterwards: a point is then two pixels wide and floors have fewer gaps.
    scale = max_side / 2 / max(float((upper - lower)[:2].max()), 1e-3)
    width, height = (np.maximum(16, np.ceil((upper - lower)[:2] * scale))).astype(int)
    cut = positions[:, 2] <= lower[2] + 0.85 * (upper[2] - lower[2])
    order = np.argsort(positions[cut, 2], kind="stable")
    x, y = _to_picture(positions[cut][order], lower, scale, height)
    picture = np.full((height, width, 3), 250, dtype=np.uint8)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    picture[y[inside], x[inside]] = colors[cut][order][inside]
    drawn = Image.fromarray(picture).resize((2 * width, 2 * height), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(drawn)
    for u, v in zip(*_to_picture(index.starts.cpu().numpy(), lower, scale, height), strict=True):
        pen.ellipse((2 * int(u) - 2, 2 * int(v) - 2, 2 * int(u) + 3, 2 * int(v) + 3), fill=(30, 90, 220))
    return np.asarray(drawn, dtype=np.uint8)


def _to_picture(
    points: NDArray[np.float32], lower: NDArray[np.float64], scale: float, height: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return columns and rows of points seen from above: x to the right, y up."""
    x = ((points[:, 0] - lower[0]) * scale).astype(np.int64)
    return x, height - 1 - ((points[:, 1] - lower[1]) * scale).astype(np.int64)


def _shrunk(panorama: Panorama) -> Picture:
    shown = np.where(panorama.valid[..., None], panorama.color, _MISSING.astype(np.uint8))
    return np.asarray(Image.fromarray(shown).resize((_WIDTH, _WIDTH // 2), Image.Resampling.BILINEAR), dtype=np.uint8)


def _render(index: MapIndex, pose: Pose, colors: torch.Tensor) -> Picture:
    """Render point colours (N, 3) in 0..1 at a pose, turned into the camera's axes."""
    height, width = _WIDTH // 2, _WIDTH
    device = index.positions.device
    position = torch.from_numpy(pose.position - index.origin_offset).float().to(device)
    views = render_views(replace(index.render_cloud, colors=counted_colors(colors)), position[None], height, width)
    rotation = torch.from_numpy(pose.rotation).float().to(device)
    u, v = project(pixel_directions(height, width, device) @ rotation.T, height, width)
    row, column = v.long().clamp(0, height - 1), u.long().clamp(0, width - 1)
    missing = torch.from_numpy(_MISSING / 255).float().to(device)
    color = torch.where(views.valid[0, row, column][..., None], views.color[0, row, column], missing)
    picture: Picture = (color * 255).round().to(torch.uint8).cpu().numpy()
    return picture


def _tint(base: Picture, scores: NDArray[np.floating]) -> Picture:
    """Mix a picture with the colours of its scores (H, W); NaN becomes grey."""
    position = np.nan_to_num(np.clip(scores, 0, 1)) * (len(_STOPS) - 1)
    low = np.minimum(position.astype(int), len(_STOPS) - 2)
    share = (position - low)[..., None]
    color = _STOPS[low] * (1 - share) + _STOPS[low + 1] * share
    color = np.where(np.isnan(scores)[..., None], _MISSING, color)
    grey = base.astype(np.float64).mean(axis=2, keepdims=True)
    mixed: Picture = (0.45 * (0.5 * base + 0.5 * grey) + 0.55 * color).round().astype(np.uint8)
    return mixed
