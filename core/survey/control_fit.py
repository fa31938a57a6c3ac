"""The levelled rigid motion between control points and their places in a map: a turn about the vertical and a shift.

A map stands on Earth by such a motion. Scale and tilt, which it leaves out, are measured to tell when a unit or an axis is wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import OptionsError

Array = NDArray[np.float64]

LEAST_POINTS = 3
_LEAST_APART_M = 0.05
_LEAST_SHARE = 0.01  # of the largest distance
_LEAST_WIDTH = 0.05  # of the figure of the points seen from above, to its length
_LEAST_ACROSS_M = 0.5  # of that length: clicks are 2 cm off, which turns the heading by two degrees
_SCALE_ERROR = 0.005
_SCALE_NOISE = 3.0  # times what the residuals explain
UNITS = {0.3048: "feet", 0.001: "millimetres", 0.01: "centimetres", 0.0254: "inches"}
EXCHANGED = "with x and y exchanged they fit: name the columns, for some surveyors write north before east"
_WORST_SHARE = 0.05  # of the extent of the points, that their residuals may be
_SWAP = 0.2  # of the residuals, with which exchanged axes fit
_WRONG = 0.33  # of what the others leave without any other point, that they leave without the wrong one


@dataclass(frozen=True)
class LevelFit:
    """known = turn about z by `yaw_rad` of position + shift, metres.

    residuals: (n, 3), position moved minus known, along the axes of the known coordinates. left_out_m: (n,) distance of each point from
    where the fit of the others puts it. rest_rms_m: (n,) of the others in that fit. scale: of the
    known coordinates to those of the map. scale_m: how far that moves the points, as the root of the sum of squares. tilt_deg: of a fit
    that may also tilt.
    """

    yaw_rad: float
    shift: Array
    residuals: Array
    left_out_m: Array
    rest_rms_m: Array
    scale: float
    scale_m: float
    tilt_deg: float


def fit_level(positions: Array, known: Array, names: Sequence[str]) -> LevelFit:
    """Return the motion that moves positions (n, 3) best to known coordinates (n, 3), metres, z up. names: of the points, for
    messages.

    Raises OptionsError for points that fix none, or that do not belong together, with what is wrong with them.
    """
    _check_figure(positions, known, names)
    yaw, shift = _level(positions, known)
    residuals = _turned(positions, yaw) + shift - known
    scale = _size(known) / _size(positions)
    left_out, rest = np.array([_left_out(positions, known, number) for number in range(len(known))]).T
    suspect = _suspect_words(rest, names)
    _check_scale(scale, residuals, known, suspect)
    _check_residuals(positions, known, residuals, suspect)
    return LevelFit(
        yaw, shift, residuals, left_out, rest, scale, abs(scale - 1) * _size(positions), _tilt_deg(positions, known)
    )


def _level(positions: Array, known: Array) -> tuple[float, Array]:
    a, b = positions - positions.mean(axis=0), known - known.mean(axis=0)
    across, along = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a[:, :2] * b[:, :2]).sum()
    yaw = float(np.arctan2(across, along))
    return yaw, known.mean(axis=0) - _turned(positions.mean(axis=0)[None], yaw)[0]


def _turned(points: Array, yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    turned: Array = points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return turned


def _left_out(positions: Array, known: Array, number: int) -> tuple[float, float]:
    others = np.delete(positions, number, axis=0), np.delete(known, number, axis=0)
    yaw, shift = _level(*others)
    off = np.linalg.norm(_turned(positions, yaw) + shift - known, axis=1)
    return float(off[number]), rms_of(np.delete(off, number))


def rms_of(off: Array) -> float:
    """Return the root mean square of distances or coordinates, of any shape."""
    return float(np.sqrt(np.square(off).mean()))


def _size(points: Array) -> float:
    return float(np.sqrt(np.square(points - points.mean(axis=0)).sum()))


def _tilt_deg(positions: Array, known: Array) -> float:
    """Return by how much the vertical tilts in the rigid fit without a level; 0 where the points are flat enough not to tell."""
    u, _, vt = np.linalg.svd((known - known.mean(axis=0)).T @ (positions - positions.mean(axis=0)))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return float(np.degrees(np.arccos(np.clip(rotation[2, 2], -1, 1))))


def _check_figure(positions: Array, known: Array, names: Sequence[str]) -> None:
    if len(known) < LEAST_POINTS:
        raise OptionsError(
            f"points: expected {LEAST_POINTS} or more points with a place in the scan, got {len(known)}; click more of them in the scan"
        )
    for what, points in (("in the scan", positions), ("by their coordinates", known)):
        apart = np.linalg.norm(points[:, None] - points[None], axis=2)
        least = min(_LEAST_APART_M, _LEAST_SHARE * apart.max())  # coordinates may be in other units
        apart += 1e9 * np.eye(len(points))
        if apart.min() <= least:
            one, other = sorted(divmod(int(apart.argmin()), len(points)))
            raise OptionsError(
                f"points: expected points apart from each other, got {names[one]} and {names[other]} at the same place {what}; "
                "correct or remove one of them"
            )
        _, widths, _ = np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0))
        if widths[0] < _LEAST_ACROSS_M * _size(points) / _size(positions):  # coordinates may be in other units
            raise OptionsError(
                f"points: expected points that lie apart horizontally, got points above each other {what}, which leave the heading open; "
                f"add points more than {_LEAST_ACROSS_M:g} m to the side"
            )
        if widths[1] < _LEAST_WIDTH * widths[0]:
            raise OptionsError(
                f"points: expected points that are not in one line as seen from above, got such a line {what}; add a point to its side"
            )


def _suspect_words(rest_rms_m: Array, names: Sequence[str]) -> str | None:
    """Return what to check of the point without which the others fit far better than without any other; None where there is none."""
    suspect, second = np.argsort(rest_rms_m)[:2]
    if len(names) <= LEAST_POINTS or rest_rms_m[suspect] > _WRONG * rest_rms_m[second]:
        return None
    fit = f"without {names[suspect]} the others fit to {rest_rms_m[suspect]:.3f} m"
    return f"{fit}: check its coordinates and its place in the scan, or remove it"


def _check_scale(scale: float, residuals: Array, known: Array, suspect: str | None) -> None:
    size = _size(known)
    if abs(scale - 1) <= _SCALE_ERROR:
        return
    guesses = [
        f"as if the {what} were in {unit}"
        for factor, unit in UNITS.items()
        for what, size_of in (("positions of the map", factor), ("coordinates", 1 / factor))
        if abs(scale / size_of - 1) < 0.02
    ]
    if not guesses and abs(scale - 1) * size < _SCALE_NOISE * rms_of(residuals):
        return  # of points that fit badly anyway: `_check_residuals` says so
    why = suspect or "which no unit explains: compare one distance in scan and list"
    if guesses:
        why = f"{guesses[0]}; correct the unit of the scan or of the coordinates"
    raise OptionsError(
        f"points: expected distances as in the map, got known coordinates whose distances are {scale:.4g} times those, {why}"
    )


def _check_residuals(positions: Array, known: Array, residuals: Array, suspect: str | None) -> None:
    rms = float(np.sqrt(np.square(residuals).sum(axis=1).mean()))
    extent = float(np.linalg.norm(np.ptp(known, axis=0)))
    if rms <= _WORST_SHARE * extent:
        return
    exchanged = known[:, [1, 0, 2]]
    yaw, shift = _level(positions, exchanged)
    swapped = float(np.sqrt(np.square(_turned(positions, yaw) + shift - exchanged).sum(axis=1).mean()))
    why = suspect or "check their coordinates, their order and their places in the scan"
    if swapped < _SWAP * rms:
        why = EXCHANGED
    raise OptionsError(
        f"points: expected points that fit together, got residuals of {rms:.2f} m over {extent:.1f} m; {why}"
    )
