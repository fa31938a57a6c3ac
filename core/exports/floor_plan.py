"""The floors of a map for plans: which photos stand on which, and each floor from above."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.scan.from_above import EMPTY, Area, draw_from_above
from panoloc.core.scan.reading import read_points_of_map

Array = NDArray[np.float64]

_EYE_M = 1.6  # of a photo above its floor, where no floor was found
_BELOW_M = 0.3  # floors are not quite level
_OVERHEAD_M = 2.1  # lower than ceilings and lintels, which hide rooms and doors
_UNDER_NEXT_M = 0.5  # the next floor and what carries it
_EDGES = 0.001  # share of points, at each end, that are no part of the building
_MARGIN_M = 0.5
_CELL_M = 0.05  # of the picture, two pixels: about the distance of points in a thinned scan
_MAX_SIDE = 2400  # pixels
_INK = (38, 42, 50, 255)
SECTION_M, SECTION_HALF_M = 1.2, 0.2
"""Height above the floor at which a plan is cut, and how far above and below it points count: scans are thinned."""
_QUALITY = 80


@dataclass(frozen=True)
class Points:
    """The points of a scan. positions: (N, 3) metres, in the map's own frame. colors: (N, 3) uint8."""

    positions: Array
    colors: NDArray[np.uint8]


@dataclass(frozen=True)
class Storey:
    """One floor of a map. level_m: of the floor; top_m: below the next one, infinite for the last. photos: their numbers in the tour."""

    level_m: float
    top_m: float
    photos: tuple[int, ...]

    def points_of(self, points: Points, lower_m: float, upper_m: float) -> Points:
        """Return the points between two heights above the floor, none of the next floor."""
        heights = points.positions[:, 2]
        chosen = (heights >= self.level_m + lower_m) & (heights <= min(self.level_m + upper_m, self.top_m))
        return Points(points.positions[chosen], points.colors[chosen])


@dataclass(frozen=True)
class FloorPicture:
    """A floor from above. pixels: (H, W, 4) uint8, clear where the scan shows nothing. left, top: metres, of its upper left corner;
    pixels_per_m: x to the right, y up.
    """

    pixels: NDArray[np.uint8]
    left: float
    top: float
    pixels_per_m: float

    def webp(self) -> bytes:
        """Return it as a WebP."""
        out = io.BytesIO()
        Image.fromarray(self.pixels).save(out, "WEBP", quality=_QUALITY)
        return out.getvalue()


def points_of(tour: Tour) -> Points:
    """Return the points of the map, none without a scan."""
    if tour.scan is None:
        return Points(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    cloud = read_points_of_map(tour.scan)
    return Points(cloud.positions.astype(np.float64) + cloud.origin_offset, cloud.colors)


def storeys_of(photos: Sequence[PlacedPhoto], levels_m: Sequence[float], points: Points) -> list[Storey]:
    """Return the floors, bottom up, at least one. levels_m: of the floors that were found in the scan."""
    eyes = np.array([photo.map_from_camera.position[2] for photo in photos])
    levels = sorted(levels_m) or [_only_level(eyes, points)]
    # A photo on the stairs below the lowest floor belongs to that.
    storey_of = np.maximum(np.searchsorted(levels, eyes, "right") - 1, 0)
    tops = [*(level - _UNDER_NEXT_M for level in levels[1:]), np.inf]
    return [
        Storey(level, top, tuple(np.flatnonzero(storey_of == number).tolist()))
        for number, (level, top) in enumerate(zip(levels, tops, strict=True))
    ]


def draw_storey(storey: Storey, photos: Sequence[PlacedPhoto], points: Points) -> FloorPicture:
    """Draw a floor as it is seen from under its ceiling, with what stands at the height of the section in dark."""
    seen = storey.points_of(points, -_BELOW_M, _OVERHEAD_M)
    lower, upper = _bounds(storey, photos, seen)
    side = min(_MAX_SIDE, round(2 * float((upper - lower).max()) / _CELL_M))
    drawn = draw_from_above(seen.positions, seen.colors, Area(lower, upper, np.inf), side)
    cut = section_of(storey, points).positions
    columns, rows = drawn.pixels_of(cut).T
    height, width = drawn.picture.shape[:2]
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    pixels = np.dstack([drawn.picture, np.where((drawn.picture == EMPTY).all(axis=2), 0, 255).astype(np.uint8)])
    for down in (0, 1):
        for aside in (0, 1):
            pixels[rows[inside] + down, columns[inside] + aside] = _INK
    return FloorPicture(pixels, float(lower[0]), float(lower[1]) + height / drawn.pixels_per_m, drawn.pixels_per_m)


def section_of(storey: Storey, points: Points) -> Points:
    """Return the points that a plan of the floor is cut through."""
    return storey.points_of(points, SECTION_M - SECTION_HALF_M, SECTION_M + SECTION_HALF_M)


def _bounds(storey: Storey, photos: Sequence[PlacedPhoto], seen: Points) -> tuple[Array, Array]:
    """Return the lower and upper corner, each (2,), of what a plan of a floor has to show."""
    places = np.array([photos[number].map_from_camera.position for number in storey.photos]).reshape(-1, 3)
    corners = [places.min(axis=0), places.max(axis=0)] if len(places) else []
    if len(seen.positions):
        corners += [np.quantile(seen.positions, share, axis=0) for share in (_EDGES, 1 - _EDGES)]
    corners = corners or [np.zeros(3)]
    return np.min(corners, axis=0)[:2] - _MARGIN_M, np.max(corners, axis=0)[:2] + _MARGIN_M


def _only_level(eyes: Array, points: Points) -> float:
    """Return the level of the floor of a map in which none was found."""
    if len(eyes):
        return float(eyes.min()) - _EYE_M
    return float(np.quantile(points.positions[:, 2], _EDGES)) if len(points.positions) else 0.0
