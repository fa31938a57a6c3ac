"""The plan: a scan from above, with where each photo was taken, where it looks, and its number on the contact sheet."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from panoloc.core.exports.overview.placement import COLOR_OF, INK, PAPER, PhotoSeen, Placement, font_of, legible
from panoloc.core.options import ScanOptions
from panoloc.core.scan.from_above import Area, SeenFromAbove, draw_from_above
from panoloc.core.scan.reading import read_scan

_MAX_SIDE = 1200  # pixels
_MARGIN_M = 0.5  # around photos that lie at the edge of the scan, or beyond
_OVERHEAD_M = 0.4  # over the highest photo: what is above hides the rooms
_CEILING = 0.85  # of the height of a scan without photos
_EDGES = 0.001  # share of points, at each end, that are no part of the building
_RADIUS, _ARROW, _LEGEND = 7, 26, 34  # pixels
_SMALL = 15  # pixels of letters
_MAX_NUMBERS = 4  # of photos taken at one place
_BAR_STEPS_M = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_EMPTY_ROOM_M = 5.0


def draw_plan(placement: Placement) -> NDArray[np.uint8]:
    """Return (H, W, 3), x to the right, y up. A filled dot with an arrow along the heading is a photo. Hollow dots of the
    same number are the other poses of an ambiguous one. Below are a scale and a legend of the colours.
    """
    places = np.array([pose.position for photo in placement.photos for pose in photo.poses]).reshape(-1, 3)
    seen = _scan(placement, places)
    height, width = seen.picture.shape[:2]
    drawn = Image.new("RGB", (max(width, 700), height + _LEGEND), PAPER)
    drawn.paste(Image.fromarray(seen.picture), (0, 0))
    pen = ImageDraw.Draw(drawn)
    for photo in reversed(placement.photos):
        _draw_photo(pen, seen, photo)
    _draw_numbers(pen, seen, placement)
    _draw_legend(pen, seen, placement, height)
    return np.asarray(drawn, dtype=np.uint8)


def _scan(placement: Placement, places: NDArray[np.float64]) -> SeenFromAbove:
    positions, colors = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    if placement.scan is not None:
        cloud = read_scan(placement.scan, ScanOptions())
        positions, colors = cloud.positions.astype(np.float64) + cloud.origin_offset, cloud.colors
    corners = [np.quantile(positions, share, axis=0) for share in (_EDGES, 1 - _EDGES)] if len(positions) else []
    if len(places):
        corners += [places.min(axis=0) - _MARGIN_M, places.max(axis=0) + _MARGIN_M]
    if not corners:
        corners = [np.zeros(3), np.full(3, _EMPTY_ROOM_M)]
    lower, upper = np.min(corners, axis=0), np.max(corners, axis=0)
    top_m = float(lower[2] + _CEILING * (upper[2] - lower[2]))
    if len(places):
        top_m = min(top_m, float(places[:, 2].max()) + _OVERHEAD_M)
    return draw_from_above(positions, colors, Area(lower[:2], upper[:2], top_m), _MAX_SIDE)


def _draw_photo(pen: ImageDraw.ImageDraw, seen: SeenFromAbove, photo: PhotoSeen) -> None:
    color = COLOR_OF[photo.status]
    for rank, pose in enumerate(photo.poses):
        ((column, row),) = seen.pixels_of(pose.position[None]).tolist()
        ahead = pose.rotation[:2, 0]
        level = float(np.hypot(*ahead))
        if level > 1e-6:
            tip = column + _ARROW * ahead[0] / level, row - _ARROW * ahead[1] / level
            pen.line((column, row, *tip), fill=PAPER, width=7)
            pen.line((column, row, *tip), fill=color, width=3)
        dot = (column - _RADIUS, row - _RADIUS, column + _RADIUS, row + _RADIUS)
        pen.ellipse(dot, fill=color if rank == 0 else PAPER, outline=PAPER if rank == 0 else color, width=2)


def _draw_numbers(pen: ImageDraw.ImageDraw, seen: SeenFromAbove, placement: Placement) -> None:
    """Write the numbers of photos beside their dots; those taken at one place share a line."""
    at_place: dict[tuple[int, int], list[PhotoSeen]] = {}
    for photo in placement.photos:
        for pose in photo.poses:
            ((column, row),) = seen.pixels_of(pose.position[None]).tolist()
            at_place.setdefault((column // _RADIUS, row // _RADIUS), []).append(photo)
    for (column, row), photos in at_place.items():
        text = ", ".join(str(photo.number) for photo in photos[:_MAX_NUMBERS])
        text += f" +{len(photos) - _MAX_NUMBERS}" if len(photos) > _MAX_NUMBERS else ""
        at = (column + 2) * _RADIUS + 3, row * _RADIUS - 9
        pen.text(at, text, fill=COLOR_OF[photos[0].status], font=font_of(18), stroke_width=3, stroke_fill=PAPER)


def _draw_legend(pen: ImageDraw.ImageDraw, seen: SeenFromAbove, placement: Placement, top: int) -> None:
    bar_m = max((step for step in _BAR_STEPS_M if step * seen.pixels_per_m <= 200), default=_BAR_STEPS_M[0])
    row, at = top + _LEGEND // 2, 12.0
    pen.line((at, row, at + bar_m * seen.pixels_per_m, row), fill=INK, width=3)
    at = _write(pen, at + bar_m * seen.pixels_per_m + 6, row, f"{bar_m:g} m", INK)
    for status, color in COLOR_OF.items():
        number = sum(photo.status == status for photo in placement.photos)
        if number:
            at = _write(pen, at + 24, row, f"{number} {status.replace('_', ' ')}", color)
    shown = sum(bool(photo.poses) for photo in placement.photos)
    name = legible(placement.map_name, font_of(_SMALL))
    _write(pen, at + 24, row, f"{shown} of {len(placement.photos)} drawn; y up; {name}", INK)


def _write(pen: ImageDraw.ImageDraw, column: float, row: float, text: str, color: tuple[int, int, int]) -> float:
    font = font_of(_SMALL)
    pen.text((column, row), text, fill=color, font=font, anchor="lm")
    return column + font.getlength(text)
