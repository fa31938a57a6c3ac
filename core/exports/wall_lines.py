"""Straight walls in the section of a floor: a Hough transform whose points each count for one line."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CELL_M = 0.02  # points of one cell are one
_MOST_CELLS = 60_000  # cells grow for more
_NUM_ANGLES = 180
_BIN_M = 0.03  # of the distance of lines from the origin
_NEAR_M = 0.03  # of a point from its line: noise of scans
_GAP_M = 0.3  # in a wall; doors are wider
_SHORTEST_M = 0.5
_FILLED = 0.75  # of a line's length that has points
_STEP_M = 0.06  # of that length; points of a thinned scan lie closer
_MOST_LINES = 5000


def wall_lines(places: Array) -> tuple[Array, Array]:
    """Return segments (S, 2, 2) from end to end, the longest walls first, and the places (M, 2) that are on none.

    places: (N, 2) metres, of the points of a section.
    """
    if not len(places):
        return np.zeros((0, 2, 2)), np.zeros((0, 2))
    origin = np.floor(places.min(axis=0))
    cells = _cells(places - origin)
    angles = np.arange(_NUM_ANGLES) * np.pi / _NUM_ANGLES
    normals = np.stack([np.cos(angles), np.sin(angles)])
    farthest = float(np.hypot(*cells.max(axis=0)))
    num_bins = 2 * int(np.ceil(farthest / _BIN_M)) + 3
    bins = np.rint(cells @ normals / _BIN_M).astype(np.int32) + num_bins // 2
    votes = np.zeros((_NUM_ANGLES, num_bins), np.int32)
    _vote(votes, bins, 1)
    is_left, segments = np.ones(len(cells), np.bool_), []
    least = int(_FILLED * _SHORTEST_M / _STEP_M)
    for _ in range(_MOST_LINES):
        angle, middle = np.unravel_index(int(votes.argmax()), votes.shape)
        if votes[angle, middle] < least:
            break
        numbers = np.flatnonzero(is_left & (np.abs(bins[:, angle] - middle) <= 1))
        found = _longest_run(cells, numbers)
        if found is None:
            votes[angle, middle] = 0
            continue
        segment, on_it = found
        segments.append(segment + origin)
        is_left[on_it] = False
        _vote(votes, bins[on_it], -1)
    order = np.argsort([-np.hypot(*(end - start)) for start, end in segments], kind="stable")
    return np.array(segments).reshape(-1, 2, 2)[order], cells[is_left] + origin


def _cells(places: Array) -> Array:
    """Return the mean place of the points in each cell that has some."""
    size = _CELL_M
    while True:
        _, numbers, counts = np.unique(
            np.floor(places / size).astype(np.int64), axis=0, return_inverse=True, return_counts=True
        )
        if len(counts) <= _MOST_CELLS:
            sums = [np.bincount(numbers.ravel(), places[:, axis]) for axis in (0, 1)]
            return np.stack(sums, axis=1) / counts[:, None]
        size *= 1.5


def _vote(votes: NDArray[np.int32], bins: NDArray[np.int32], by: int) -> None:
    """Add to the votes (A, B) those of points, by their bins (N, A)."""
    for angle, of_angle in enumerate(bins.T):
        votes[angle] += by * np.bincount(of_angle, minlength=votes.shape[1]).astype(np.int32)
    np.maximum(votes, 0, out=votes)


def _longest_run(cells: Array, numbers: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]] | None:
    """Return the longest wall among points about a line, as a segment (2, 2) with the numbers of its points; None without one."""
    for _ in range(2):  # a fitted line has more of its points near than the line of the vote
        if len(numbers) < 2:
            return None
        middle, ahead = _fit(cells[numbers])
        along, aside = (cells[numbers] - middle) @ ahead, (cells[numbers] - middle) @ np.array([-ahead[1], ahead[0]])
        near = np.abs(aside) <= _NEAR_M
        numbers, along = numbers[near], along[near]
        order = np.argsort(along)
        numbers, along = numbers[order], along[order]
        if not len(along):
            return None
        cuts = np.flatnonzero(np.diff(along) > _GAP_M) + 1
        starts, ends = np.r_[0, cuts], np.r_[cuts, len(along)]
        best = int(np.argmax(along[ends - 1] - along[starts]))
        numbers, along = numbers[starts[best] : ends[best]], along[starts[best] : ends[best]]
    length = float(along[-1] - along[0])
    filled = len(np.unique(np.floor(along / _STEP_M))) * _STEP_M
    if length < _SHORTEST_M or filled < _FILLED * length:
        return None
    return middle + np.outer([along[0], along[-1]], ahead), numbers


def _fit(places: Array) -> tuple[Array, Array]:
    """Return the middle of places (N, 2) and the direction in which they spread most, both (2,)."""
    middle = places.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((places - middle).T, bias=True))
    return middle, axes[:, 1]
