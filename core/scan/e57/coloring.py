"""Colour points by images with known poses: each point gets the colour of the nearest image that shows it.

A depth image around each place tells what is visible there: a point behind nearer ones is hidden.
"""

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError
from panoloc.core.options import MAX_PIXELS
from panoloc.core.scan.e57.images import SAME_PLACE_M, E57Image, Pinhole

MAX_IMAGES = 400
_DEPTH_ROWS, _DEPTH_COLUMNS = 256, 512  # 0.7 degrees: what scans of a few centimetres fill at a few metres
_FARTHEST_M = 40.0  # farther away a pixel shows more than the details of a point
_NEAREST_M = 0.05
_TOLERANCE, _TOLERANCE_M = 0.06, 0.08  # floors that a pixel sees at a slant
# A direction whose neighbours are mostly nearer than this share of its distance is a gap between nearer points.
_HOLE = 0.7
_MOST_NEIGHBOURS = 5  # of eight
_COLOR_PIXELS = 160_000_000  # of all panoramas together, in memory as bytes of red, green and blue
_WIDEST = 4096


@dataclass(frozen=True)
class _View:
    """One image: from its axes to the file's, and its colours (h, w, 3). pinhole: None of a panorama."""

    rotation: NDArray[np.float64]
    colors: NDArray[np.uint8]
    pinhole: Pinhole | None

    def colors_in(self, offsets: NDArray[np.float64]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return what the image shows in directions (n, 3) in the file's axes, and which of them it shows at all."""
        directions = offsets @ self.rotation
        height, width = self.colors.shape[:2]
        if self.pinhole is None:
            row, column = _pixels(directions, height, width)
            return self.colors[row, column], np.ones(len(directions), np.bool_)
        forward, left, up = directions.T
        with np.errstate(divide="ignore", invalid="ignore"):
            across = (self.pinhole.cx - self.pinhole.fx * left / forward) / self.pinhole.width
            down = (self.pinhole.cy - self.pinhole.fy * up / forward) / self.pinhole.height
            shown = (forward > 0) & (across >= 0) & (across < 1) & (down >= 0) & (down < 1)
        row, column = ((at[shown] * size).astype(np.int64) for at, size in ((down, height), (across, width)))
        found = np.zeros((len(directions), 3), np.uint8)
        found[shown] = self.colors[row, column]
        return found, shown


@dataclass
class _Station:
    """A place with its images. depth: the distance of the nearest point in each direction, in the file's axes."""

    position: NDArray[np.float64]
    depth: NDArray[np.float64]
    views: list[_View]


class ImageColors:
    """Used in two passes over the points: `add` all of them, then `of` each chunk."""

    def __init__(self, images: Sequence[E57Image]) -> None:
        """images: with poses, at most MAX_IMAGES. Raises ScanContentError for one that does not decode."""
        widest = min(_WIDEST, int(np.sqrt(2 * _COLOR_PIXELS / max(1, len(images)))))
        self._stations: list[_Station] = []
        for image in images:
            assert image.position is not None
            self._station_at(image.position).views.append(_view(image, widest))

    def _station_at(self, position: NDArray[np.float64]) -> _Station:
        for known in self._stations:
            if np.linalg.norm(known.position - position) < SAME_PLACE_M:
                return known
        self._stations.append(_Station(position, np.full((_DEPTH_ROWS, _DEPTH_COLUMNS), np.inf), []))
        return self._stations[-1]

    def add(self, positions: NDArray[np.float64]) -> None:
        """Note what points (n, 3), in the file's frame, hide."""
        for station in self._stations:
            _, offsets, distances = _near(station, positions)
            np.minimum.at(station.depth, _pixels(offsets, _DEPTH_ROWS, _DEPTH_COLUMNS), distances)

    def close_gaps(self) -> None:
        """End the first pass: a gap between nearer points becomes as near as they are."""
        for station in self._stations:
            rows = np.pad(station.depth, ((1, 1), (0, 0)), mode="edge")
            windows = sliding_window_view(np.pad(rows, ((0, 0), (1, 1)), mode="wrap"), (3, 3))
            around = windows.reshape(_DEPTH_ROWS, _DEPTH_COLUMNS, 9)
            nearer = around < _HOLE * station.depth[..., None]
            is_gap = nearer.sum(axis=-1) >= _MOST_NEIGHBOURS
            station.depth = np.where(is_gap, np.where(nearer, around, 0).max(axis=-1), station.depth)

    def of(self, positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the colours (n, 3) of points in 0..255, and which points any image shows."""
        best = np.full(len(positions), np.inf)
        colors = np.zeros((len(positions), 3))
        for station in self._stations:
            near, offsets, distances = _near(station, positions)
            depth = station.depth[_pixels(offsets, _DEPTH_ROWS, _DEPTH_COLUMNS)]
            seen = (distances <= depth * (1 + _TOLERANCE) + _TOLERANCE_M) & (distances < best[near])
            near, offsets, distances = near[seen], offsets[seen], distances[seen]
            for view in station.views:
                found, shown = view.colors_in(offsets)
                colors[near[shown]] = found[shown]
                best[near[shown]] = distances[shown]
        return colors, np.isfinite(best)


def with_poses(images: Iterable[E57Image]) -> list[E57Image]:
    """Return those whose pose is known, no more than are used."""
    return [image for image in images if image.rotation is not None and image.position is not None][:MAX_IMAGES]


def _view(image: E57Image, widest: int) -> _View:
    from PIL import Image  # only here: the benchmarks of the core run where Pillow is not

    assert image.rotation is not None
    try:
        with Image.open(io.BytesIO(image.read()), formats=("JPEG", "PNG")) as opened:
            if opened.size[0] * opened.size[1] > MAX_PIXELS:
                raise ValueError(f"it has {opened.size[0]} x {opened.size[1]} pixels; the limit is {MAX_PIXELS:,}")
            opened.draft("RGB", (widest, widest // 2))
            opened.thumbnail((widest, widest // 2), Image.Resampling.BOX)
            colors = np.asarray(opened.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:
        raise ScanContentError(
            f"The scan has no colours of its own, and its image {image.name[:80]!r} cannot be read: {error}. Export the scan with colours."
        ) from error
    return _View(image.rotation, colors, image.pinhole)


def _near(
    station: _Station, positions: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the numbers of the points in reach, their offsets from the station (m, 3), and their distances."""
    offset = positions - station.position
    squared = np.einsum("ij,ij->i", offset, offset)
    with np.errstate(invalid="ignore"):  # points that the scanner calls invalid are NaN
        near = np.flatnonzero((squared < _FARTHEST_M**2) & (squared > _NEAREST_M**2))
    return near, offset[near], np.sqrt(squared[near])


def _pixels(directions: NDArray[np.float64], height: int, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of directions (n, 3) in an equirectangular image."""
    x, y, z = directions.T
    column = ((0.5 - np.arctan2(y, x) / (2 * np.pi)) * width).astype(np.int64) % width
    row = ((0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * height).astype(np.int64)
    return np.clip(row, 0, height - 1), column
