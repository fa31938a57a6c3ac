"""Around the poles: patches and logos drawn by the camera's software, and what stitchers fill in, mirrored or blurred."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

_LARGEST_DEG, _SMALLEST_DEG = 45.0, 5.0  # from the pole to the rim
_LEAST_HEIGHT = 256  # rows of the sphere, below which a few rows are no evidence
_STEP_LEVELS = 14
_RING_SHARE = 0.75  # of all azimuths that have a step at the same elevation
_RING_ODDS = 2.5  # how much more common it is there than in the rows around
_BLUR_RATIO = 0.35  # of the detail beyond the rim to that inside
_LEAST_DETAIL = 0.8  # levels of the mean second difference, above which there was something to blur
_LEAST_SLOPE = 0.5  # levels a row, root mean square, above which there was something to mirror
_NUM_SECTORS = 16
_SECTOR_SHARE = 0.8
_MIRROR_CORRELATION = 0.6
_MOST_MIRROR_ROWS = 48
_SMOOTH_ROWS = 17
_RIM_ROWS = 2


def find_polar_fills(planes: NDArray[np.uint8], valid: Mask, is_sphere: bool) -> Iterator[tuple[str, Mask]]:
    """Yield name and mask (h, w) of what covers a pole of a sphere (3, h, w)."""
    height = len(valid)
    if not is_sphere or height < _LEAST_HEIGHT:
        return
    rows = int(height * _LARGEST_DEG / 90)  # twice the largest cap, so that there is as much beside it
    for pole, part, counts in (
        ("top", planes[:, :rows], valid[:rows]),
        ("bottom", planes[:, ::-1][:, :rows], valid[::-1][:rows]),
    ):
        if not counts[: rows // 2].all():
            continue
        kind, cap = _cap(part, height)
        if cap:
            found = np.zeros(valid.shape, np.bool_)
            (found if pole == "top" else found[::-1])[: cap + _RIM_ROWS] = True
            yield f"{kind} around the {pole} pole", found


def _cap(part: NDArray[np.uint8], height: int) -> tuple[str, int]:
    """Return what covers the pole, which is at the first row, and the number of its rows, 0 where nothing does."""
    least, most = int(height * _SMALLEST_DEG / 180), int(height * _LARGEST_DEG / 180)
    cap = _ring(part[..., ::2], least, most)
    if cap:
        return "a patch with a round rim", cap
    grey = part[..., ::4].mean(axis=0, dtype=np.float32)
    cap = _mirror(grey[:, ::2], least, most)
    if cap:
        return "a mirrored fill", cap
    return "a blurred fill", _blur(grey, least, most)


def _ring(part: NDArray[np.uint8], least: int, most: int) -> int:
    """Return the outermost row at which nearly all azimuths have a step, 0 without one."""
    rows = part[:, : most + 16].astype(np.int16)
    # Between rows r and r + 3: resampling and compression take a row on either side.
    step = (np.abs(rows[:, 3:] - rows[:, :-3]).max(axis=0) > _STEP_LEVELS).mean(axis=1)
    for at in np.flatnonzero(step[: most + 1] >= _RING_SHARE)[::-1].tolist():
        beside = np.concatenate((step[max(at - 12, 0) : max(at - 4, 0)], step[at + 5 : at + 13]))
        if at >= least and step[at] >= step[at - 1 : at + 2].max() and step[at] >= _RING_ODDS * np.median(beside):
            return int(at) + 2
    return 0


def _mirror(grey: NDArray[np.float32], least: int, most: int) -> int:
    """Return the row in which what lies before it is mirrored, 0 without one.

    Derivatives by the row change their sign in a mirror; what has none, as the edges of walls, looks mirrored everywhere.
    """
    slope = np.diff(grey, axis=0)
    slope -= slope.mean(axis=1, keepdims=True)
    # Light that rises and falls smoothly is symmetric around where it is brightest.
    reach = _SMOOTH_ROWS // 2
    total = np.pad(slope, ((reach + 1, reach), (0, 0)), mode="edge").cumsum(axis=0)
    slope -= (total[_SMOOTH_ROWS:] - total[:-_SMOOTH_ROWS]) / _SMOOTH_ROWS
    best, found = _MIRROR_CORRELATION, 0
    for at in range(least, min(most, len(grey) // 2)):
        deep = min(at - 1, _MOST_MIRROR_ROWS)
        inside, outside = slope[at - 1 - deep : at - 1], slope[at : at + deep][::-1]
        scale = float(np.vdot(inside, inside) * np.vdot(outside, outside)) ** 0.5
        if scale > inside.size * _LEAST_SLOPE**2:
            correlation = -float(np.vdot(inside, outside)) / scale
            if correlation > best:
                best, found = correlation, at
    return found


def _blur(grey: NDArray[np.float32], least: int, most: int) -> int:
    """Return the row before which there is next to no detail in any direction and after which there is, 0 without one."""
    detail = np.abs(grey[2:] - 2 * grey[1:-1] + grey[:-2])
    sectors = (
        detail[:, : detail.shape[1] // _NUM_SECTORS * _NUM_SECTORS].reshape(len(detail), _NUM_SECTORS, -1).mean(axis=2)
    )
    total = np.concatenate((np.zeros((1, _NUM_SECTORS), np.float32), sectors.cumsum(axis=0)))
    at = np.arange(least, min(most, len(sectors) - 12))[:, None]
    if not len(at):
        return 0
    column = np.arange(_NUM_SECTORS)
    inside = total[at - 2, column] / (at - 2)
    beside = (total[at - 2, column] - total[np.maximum(at - 10, 0), column]) / np.minimum(8, at - 2)
    outside = (total[at + 10, column] - total[at + 2, column]) / 8
    sharp = (outside >= _LEAST_DETAIL) & (np.maximum(inside, beside) < _BLUR_RATIO * outside)
    share = sharp.mean(axis=1)
    return int(at[len(share) - 1 - share[::-1].argmax(), 0]) if share.max() >= _SECTOR_SHARE else 0
