"""Links of a tour: from each photo to the next ones that the scan lets it see."""

import numpy as np
from numpy.typing import NDArray

Positions = NDArray[np.float64]

_CANDIDATES = 32  # nearest photos of which each is asked whether it is seen
_FARTHEST_M = 100.0  # that a photo is looked for: rays are as long as that at most
_FINEST_CELL_M, _COARSEST_CELL_M = 0.06, 0.3
_POINTS_PER_CELL = 4.0  # so that a wall of random points has a hole in one of fifty cells
_BESIDE_M = 0.12  # of the rays beside the middle one: a lamp or a door frame stops few of nine, a wall most
_STEPS_AT_ONCE = 4_000_000


def links_of(positions: Positions, points: Positions) -> list[list[int]]:
    """Return for each photo the numbers of the photos it links to, nearest first; links go both ways.

    positions: (n, 3) of the photos, points: (m, 3) of the scan, both in metres in one frame. Two photos are linked that see each other
    past the points within 100 m, unless a third lies between them: one that both see and that is nearer to both than they are to each
    other (relative neighbourhood graph; Toussaint 1980). So links lie at least 60 degrees apart where all see each other. Where no line of
    sight joins two parts of a tour, as through a closed door, the shortest link does, so that every photo can be reached.
    Without points all within 100 m see each other.
    """
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    seen = _seen(positions, distance, points)
    linked = np.zeros_like(seen)
    for one, other in np.argwhere(np.triu(seen, 1)).tolist():
        between = seen[one] & seen[other] & (np.maximum(distance[one], distance[other]) < distance[one, other])
        linked[one, other] = linked[other, one] = not between.any()
    _join(linked, distance)
    return [
        sorted(np.flatnonzero(row).tolist(), key=lambda at: distance[number, at]) for number, row in enumerate(linked)
    ]


def _seen(positions: Positions, distance: NDArray[np.float64], points: Positions) -> NDArray[np.bool_]:
    """Return (n, n): which photos see each other, among the nearest of each."""
    near = np.zeros(distance.shape, np.bool_)
    np.put_along_axis(near, np.argsort(distance, axis=1)[:, : _CANDIDATES + 1], True, axis=1)
    pairs = np.argwhere(np.triu((near | near.T) & (distance < _FARTHEST_M), 1))
    seen = np.zeros_like(near)
    if len(pairs):
        first, second = pairs.T
        seen[first, second] = seen[second, first] = _sight(points).is_free(positions[first], positions[second])
    return seen


def _join(linked: NDArray[np.bool_], distance: NDArray[np.float64]) -> None:
    """Add the shortest links between parts of a tour that have none."""
    reached = np.arange(len(linked)) == 0
    while not reached.all():
        inside, outside = np.flatnonzero(reached), np.flatnonzero(~reached)
        following = linked[inside].any(axis=0) & ~reached
        if not following.any():
            between = distance[np.ix_(inside, outside)]
            row, column = np.unravel_index(np.argmin(between), between.shape)
            linked[inside[row], outside[column]] = linked[outside[column], inside[row]] = True
        reached |= following


class _Sight:
    """Which cells of space have points of the scan. taken: their numbers, ascending."""

    def __init__(self, points: Positions, cell_m: float):
        self.cell_m = cell_m
        self._origin = points.min(axis=0) if len(points) else np.zeros(3)
        cells = np.floor((points - self._origin) / cell_m).astype(np.int64)
        self._shape = cells.max(axis=0, initial=0) + 1
        self.taken = np.unique(self._numbers(cells))

    def is_free(self, starts: Positions, ends: Positions) -> NDArray[np.bool_]:
        """Return (n,): whether most of nine parallel rays from start to end (n, 3) meet no cell with points between their ends' own."""
        ahead = ends - starts
        length = np.linalg.norm(ahead, axis=1)
        ahead = ahead / np.maximum(length, 1e-9)[:, None]
        aside = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))], axis=1)
        steep = np.linalg.norm(aside, axis=1) < 1e-6
        aside[steep] = (1.0, 0.0, 0.0)
        aside /= np.linalg.norm(aside, axis=1)[:, None]
        above = np.cross(ahead, aside)
        free = np.zeros(len(starts), np.int64)
        for left in (-_BESIDE_M, 0.0, _BESIDE_M):
            for up in (-_BESIDE_M, 0.0, _BESIDE_M):
                free += ~self._meets(starts + left * aside + up * above, ahead, length)
        return free > 4

    def _meets(self, starts: Positions, ahead: Positions, length: NDArray[np.float64]) -> NDArray[np.bool_]:
        step, meets = self.cell_m / 2, np.zeros(len(starts), np.bool_)
        num_steps = int(np.ceil(length.max() / step))
        at_once = max(1, _STEPS_AT_ONCE // max(1, num_steps))
        for begin in range(0, len(starts), at_once):
            some = slice(begin, begin + at_once)
            along = np.arange(2, max(num_steps - 1, 2)) * step
            inside = along[None] < length[some, None] - self.cell_m
            rays, steps = np.nonzero(inside)
            places = starts[some][rays] + along[steps, None] * ahead[some][rays]
            meets[begin + rays[self._is_taken(places)]] = True
        return meets

    def _is_taken(self, places: Positions) -> NDArray[np.bool_]:
        cells = np.floor((places - self._origin) / self.cell_m).astype(np.int64)
        inside = ((cells >= 0) & (cells < self._shape)).all(axis=1)
        numbers = self._numbers(cells)
        at = np.minimum(np.searchsorted(self.taken, numbers), max(len(self.taken) - 1, 0))
        return inside & (self.taken[at] == numbers) if len(self.taken) else np.zeros(len(places), np.bool_)

    def _numbers(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        numbers: NDArray[np.int64] = (cells[:, 0] * self._shape[1] + cells[:, 1]) * self._shape[2] + cells[:, 2]
        return numbers


def _sight(points: Positions) -> _Sight:
    """Return cells that are large enough for walls without holes, and small enough for doors."""
    cell_m = _FINEST_CELL_M
    while len((sight := _Sight(points, cell_m)).taken) * _POINTS_PER_CELL > len(points) and cell_m < _COARSEST_CELL_M:
        cell_m *= 1.25
    return sight
