"""Colours of points from panoramas with known poses: each point gets the colour of the nearest panorama that sees it.

What a panorama sees is told by a picture of the distances of all points around it: a point behind nearer ones is hidden.
"""

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.errors import ScanContentError
from core.options import MAX_PIXELS
from core.scan.e57.images import SphericalImage

MAX_IMAGES = 400
_DEPTH_ROWS, _DEPTH_COLUMNS = 256, 512  # 0.7 degrees: what scans of a few centimetres fill at a few metres
_FARTHEST_M = 40.0  # farther away a pixel shows more than the details of a point
_NEAREST_M = 0.05
_TOLERANCE, _TOLERANCE_M = 0.06, 0.08  # floors that a pixel sees at a slant
_HOLE = 0.7  # of its own distance; most neighbours nearer than that: what is seen there is seen through a gap between points
_MOST_NEIGHBOURS = 5  # of eight
_COLOR_PIXELS = 160_000_000  # of all panoramas together, in memory as bytes of red, green and blue
_WIDEST = 4096


@dataclass
class _View:
    """One panorama: its pose, its colours (h, w, 3), and the distance of the nearest point in each direction."""

    rotation: NDArray[np.float64]
    position: NDArray[np.float64]
    colors: NDArray[np.uint8]
    depth: NDArray[np.float64]


class PanoramaColors:
    """Used in two passes over the points: `add` all of them, then `of` each chunk."""

    def __init__(self, images: Sequence[SphericalImage]) -> None:
        """images: with poses, at most MAX_IMAGES; decoded here. Raises ScanContentError for one that does not decode."""
        widest = int(np.sqrt(2 * _COLOR_PIXELS / max(1, len(images))))
        self._views = [_view(image, min(_WIDEST, widest)) for image in images]

    def add(self, positions: NDArray[np.float64]) -> None:
        """Note what points (n, 3), in the file's frame, hide."""
        for view in self._views:
            near, directions, distances = _near(view, positions)
            row, column = _pixels(directions, _DEPTH_ROWS, _DEPTH_COLUMNS)
            del near
            np.minimum.at(view.depth, (row, column), distances)

    def close_gaps(self) -> None:
        """End the first pass: directions in which points are seen through gaps between nearer ones become as near as those."""
        for view in self._views:
            padded = np.pad(view.depth, ((1, 1), (0, 0)), mode="edge")
            around = np.stack(
                [
                    np.roll(padded, aside, axis=1)[1 + down : 1 + down + _DEPTH_ROWS]
                    for down in (-1, 0, 1)
                    for aside in (-1, 0, 1)
                    if down or aside
                ]
            )
            nearer = around < _HOLE * view.depth
            behind = nearer.sum(axis=0) >= _MOST_NEIGHBOURS
            view.depth = np.where(behind, np.where(nearer, around, 0).max(axis=0), view.depth)

    def of(self, positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the colours (n, 3) of points in 0..255, and which points any panorama sees."""
        best = np.full(len(positions), np.inf)
        colors = np.zeros((len(positions), 3))
        for view in self._views:
            near, directions, distances = _near(view, positions)
            row, column = _pixels(directions, _DEPTH_ROWS, _DEPTH_COLUMNS)
            seen = distances <= view.depth[row, column] * (1 + _TOLERANCE) + _TOLERANCE_M
            seen &= distances < best[near]
            chosen = near[seen]
            height, width = view.colors.shape[:2]
            row, column = _pixels(directions[seen], height, width)
            colors[chosen] = view.colors[row, column]
            best[chosen] = distances[seen]
        return colors, np.isfinite(best)


def with_poses(images: Iterable[SphericalImage]) -> list[SphericalImage]:
    """Return those whose pose is known, no more than are used."""
    return [image for image in images if image.rotation is not None and image.position is not None][:MAX_IMAGES]


def _view(image: SphericalImage, widest: int) -> _View:
    from PIL import Image  # only here: the benchmarks of the core run where Pillow is not

    assert image.rotation is not None
    assert image.position is not None
    try:
        with Image.open(io.BytesIO(image.read()), formats=("JPEG", "PNG")) as opened:
            if opened.size[0] * opened.size[1] > MAX_PIXELS:
                raise ValueError(f"it has {opened.size[0]} x {opened.size[1]} pixels, at most {MAX_PIXELS:,} are read")
            opened.draft("RGB", (widest, widest // 2))
            opened.thumbnail((widest, widest // 2), Image.Resampling.BOX)
            colors = np.asarray(opened.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:
        raise ScanContentError(
            f"The scan has no colours of its own, and its image {image.name[:80]!r} cannot be read: {error}. Export the scan with colours."
        ) from error
    depth = np.full((_DEPTH_ROWS, _DEPTH_COLUMNS), np.inf)
    return _View(image.rotation, image.position, colors, depth)


def _near(
    view: _View, positions: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the numbers of the points that are near enough, their directions in the camera's axes (m, 3), not normed, and distances."""
    offset = positions - view.position
    squared = np.einsum("ij,ij->i", offset, offset)
    with np.errstate(invalid="ignore"):  # points that the scanner calls invalid are NaN
        near = np.flatnonzero((squared < _FARTHEST_M**2) & (squared > _NEAREST_M**2))
    return near, offset[near] @ view.rotation, np.sqrt(squared[near])


def _pixels(directions: NDArray[np.float64], height: int, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of directions (n, 3) in an equirectangular image."""
    x, y, z = directions.T
    column = ((0.5 - np.arctan2(y, x) / (2 * np.pi)) * width).astype(np.int64) % width
    row = ((0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * height).astype(np.int64)
    return np.clip(row, 0, height - 1), column
