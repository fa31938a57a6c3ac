"""Resection: the pose of a camera from directions in which it sees known points, three or more.

Three points leave up to four poses. Many positions around the points are refined at once (Gauss-Newton with damping on the
directions, each position with the rotation that fits it best), and all distinct minima are kept.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.survey.rays import directions_of

Array = NDArray[np.float64]

LEAST_PAIRS, MOST_PAIRS = 3, 100
CLICK_PX, POINT_M = 3.0, 0.01
"""Standard deviations of a clicked pixel and of a point picked in a scan."""
# Of the first positions, in sizes of the figure that the points make.
_DISTANCES = (0.15, 0.3, 0.6, 1.2, 2.4, 5.0, 10.0)
_DIRECTIONS = 48
_ROUNDS = 40
_LEAST_APART_M = 0.05
_LEAST_APART_PX = 8.0
_LEAST_WIDTH = 0.05  # of the figure, to its length: else it is a line
_MOST_RADIUS_M = 0.5
_SAME_M = 0.05
_PLAUSIBLE = 3.0  # times the misfit of the best pose, and one click
_MISFIT_DEG = 2.0
_WRONG_PX = 3 * CLICK_PX  # of the largest residual, from which on a pair may be wrong rather than clicked badly
_WRONG_TIMES = 9.0  # squares that leaving out any other pair leaves, to those without the wrong one
_MOST_NAMED = 2  # of those that may be wrong
_MOST_TRIED = 8  # of the pairs with the largest residuals
_TILT_DEG = 25.0
_RADIUS_68 = 1.08  # of a spread in three dimensions, to its root mean square


@dataclass(frozen=True)
class Resection:
    """A pose that explains the points. residuals_px: (n,), of each point. radius_m, radius_deg: in which it is with 68 %.

    tilt_deg: of the camera's left side against the horizon; of a full sphere, of its up axis. suspect: number of the pair that contradicts
    the others, None where none does or where it cannot be told.
    """

    pose: Pose
    residuals_px: Array
    radius_m: float
    radius_deg: float
    tilt_deg: float
    suspect: int | None = None


def resect(camera: Camera, pixels: Array, points: Array) -> list[Resection]:
    """Return the poses that explain pixels (n, 2) of points (n, 3), metres: the likeliest first, that of the more level camera.

    Several only where the points do not decide. Raises OptionsError for what fixes no pose, with what to click instead.
    """
    directions = _checked(camera, pixels, points)
    poses = _minima(directions, points)
    found = sorted((_resection(camera, pose, pixels, points) for pose in poses), key=lambda each: _rms(each))
    best = found[0]
    suspect = _suspect(best, directions, points)
    is_loose = suspect is not None and best.radius_m > _MOST_RADIUS_M  # because of the wrong pair
    if is_loose or _misfit_deg(best.pose, directions, points) > _MISFIT_DEG:
        which = "check which point of the scan each of them shows" if suspect is None else suspect_words(suspect)
        raise OptionsError(
            f"pairs: expected points that one place explains, got some that contradict each other by {_rms(best):.0f} px; {which}"
        )
    most = _PLAUSIBLE * _rms(best) + CLICK_PX
    found = sorted((each for each in found if _rms(each) <= most), key=lambda each: each.tilt_deg)
    if found[0].radius_m > _MOST_RADIUS_M:
        raise OptionsError(
            f"pairs: expected points that fix the camera to within {_MOST_RADIUS_M} m, got some that leave {found[0].radius_m:.2f} m open; "
            f"{_what_to_click(found[0].residuals_px)}"
        )
    found = [found[0], *(each for each in found[1:] if each.tilt_deg < _TILT_DEG)]
    return [replace(each, suspect=suspect) for each in found]


def suspect_words(number: int) -> str:
    """Return what to do about a pair, counted from 0, that contradicts the others."""
    return f"pair {number + 1} does not fit the others: click it again in photo and scan, or remove it"


def _what_to_click(off_px: Array) -> str:
    """Return what to do about points that leave a camera open; off_px: (n,) residuals."""
    if off_px.max() < _WRONG_PX:
        return "click points farther apart, near ones too, and not all in one line, on one wall or on one circle with the camera"
    worst = [number for number in np.argsort(-off_px)[:_MOST_NAMED].tolist() if off_px[number] >= _WRONG_PX]
    named = " and ".join(f"pair {number + 1} ({off_px[number]:.0f} px off)" for number in worst)
    return f"click {named} again in photo and scan, for they fit the others worst"


def residuals_px(camera: Camera, pose: Pose, pixels: Array, points: Array) -> Array:
    """Return how many pixels (n,) the points (n, 3) are from where they were clicked (n, 2), seen from a pose.

    A point that the camera does not show there counts as one behind it: as far off as the image is wide.
    """
    u, v, shown = project_to_image(camera, (points - pose.position) @ pose.rotation)
    across = np.abs(u - pixels[:, 0])
    if camera.is_whole_sphere:
        across = np.minimum(across, camera.width_px - across)
    off: Array = np.where(shown, np.hypot(across, v - pixels[:, 1]), float(camera.width_px))
    return off


def _checked(camera: Camera, pixels: Array, points: Array) -> Array:
    """Return the directions of the pixels. Raises OptionsError."""
    count = len(points)
    if not LEAST_PAIRS <= count <= MOST_PAIRS:
        raise OptionsError(
            f"pairs: expected {LEAST_PAIRS} to {MOST_PAIRS} pairs, got {count}; click more, four or more show mistakes"
        )
    directions, has_one = directions_of(camera, *pixels.T)
    if not has_one.all():
        number = int(np.argmin(has_one))
        raise OptionsError(
            f"pairs.{number}.pixel: expected a pixel of the photo, {camera.width_px} x {camera.height_px} px, that its lens shows, got "
            f"{pixels[number].tolist()}; click inside of the picture"
        )
    for one in range(count):
        for other in range(one):
            apart_px = np.linalg.norm(pixels[one] - pixels[other])
            if np.linalg.norm(points[one] - points[other]) < _LEAST_APART_M or apart_px < _LEAST_APART_PX:
                raise OptionsError(
                    f"pairs: expected points apart from each other, got pairs {other + 1} and {one + 1} at nearly the same place; "
                    "remove one of them, and click another point"
                )
    _, widths, _ = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    if widths[1] < _LEAST_WIDTH * widths[0]:
        raise OptionsError(
            "pairs: expected points that are not all in one line, got such a line; click one to its side or above it"
        )
    return directions


def _minima(directions: Array, points: Array) -> list[Pose]:
    """Return all distinct poses at which the misfit of directions is least nearby."""
    middle = points.mean(axis=0)
    size = float(np.sqrt(np.square(points - middle).sum(axis=1).mean()))
    positions = np.concatenate([middle + size * distance * _even_directions() for distance in _DISTANCES])
    positions = np.concatenate([positions, middle[None]])
    rotations = _best_rotations(positions, directions, points)
    cost, damping = _costs(rotations, positions, directions, points), np.full(len(positions), 1e-3)
    for _ in range(_ROUNDS):
        off, slopes = _misfits(rotations, positions, directions, points)
        normal = np.swapaxes(slopes, 1, 2) @ slopes
        damped = normal + damping[:, None, None] * (normal * np.eye(6) + 1e-12 * np.eye(6))
        step = -np.linalg.solve(damped, np.swapaxes(slopes, 1, 2) @ off[..., None])[..., 0]
        moved = positions + step[:, :3]
        # The rotation is best anew at each position: only the position has to be followed.
        turned = _best_rotations(moved, directions, points)
        tried = _costs(turned, moved, directions, points)
        better = tried < cost
        positions, rotations = (
            np.where(better[:, None], moved, positions),
            np.where(better[:, None, None], turned, rotations),
        )
        cost, damping = np.where(better, tried, cost), np.where(better, damping / 5, damping * 4).clip(1e-9, 1e6)
    found: list[Pose] = []
    for number in np.argsort(cost):
        if all(np.linalg.norm(positions[number] - pose.position) > _SAME_M for pose in found):
            found.append(Pose(rotations[number], positions[number]))
    return found


def _even_directions() -> Array:
    """Return unit vectors (n, 3) spread evenly: a Fibonacci lattice."""
    k = np.arange(_DIRECTIONS) + 0.5
    height, turn = 1 - 2 * k / _DIRECTIONS, k * np.pi * (1 + np.sqrt(5))
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)


def _best_rotations(positions: Array, directions: Array, points: Array) -> Array:
    """Return map_from_camera (b, 3, 3) that turns directions (n, 3) best to points (n, 3) seen from positions (b, 3) (Wahba's problem)."""
    seen = _unit(points[None] - positions[:, None])
    u, _, vt = np.linalg.svd(np.swapaxes(seen, 1, 2) @ directions)
    sign = np.ones((len(positions), 3))
    sign[:, 2] = np.sign(np.linalg.det(u @ vt))
    best: Array = (u * sign[:, None]) @ vt
    return best


def _misfits(rotations: Array, positions: Array, directions: Array, points: Array) -> tuple[Array, Array]:
    """Return how far directions are off (b, 3n), in radians while small, and its slopes (b, 3n, 6) by position and rotation."""
    apart = points[None] - positions[:, None]
    distance = np.linalg.norm(apart, axis=2)
    seen = (apart / np.maximum(distance, 1e-9)[..., None]) @ rotations  # in the camera
    across = np.eye(3) - seen[..., :, None] * seen[..., None, :]
    by_position = -(across @ np.swapaxes(rotations, 1, 2)[:, None]) / np.maximum(distance, 1e-9)[..., None, None]
    x, y, z = np.moveaxis(seen, -1, 0)
    o = np.zeros_like(x)
    by_rotation = np.moveaxis(np.array([[o, -z, y], [z, o, -x], [-y, x, o]]), (0, 1), (-2, -1))
    slopes = np.concatenate([by_position, by_rotation], axis=3)
    count = 3 * len(points)
    return (seen - directions).reshape(-1, count), slopes.reshape(-1, count, 6)


def _costs(rotations: Array, positions: Array, directions: Array, points: Array) -> Array:
    seen = _unit(points[None] - positions[:, None]) @ rotations
    return np.asarray(np.square(seen - directions).sum(axis=(1, 2)))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))


def _misfit_deg(pose: Pose, directions: Array, points: Array) -> float:
    return float(np.degrees(np.sqrt(_cost(pose, directions, points) / len(points))))


def _cost(pose: Pose, directions: Array, points: Array) -> float:
    return float(_costs(pose.rotation[None], pose.position[None], directions, points)[0])


def _suspect(best: Resection, directions: Array, points: Array) -> int | None:
    """Return the number of the pair without which the others agree far better than without any other; None where there is none.

    Four pairs cannot tell: the three that are left always agree.
    """
    if len(points) <= LEAST_PAIRS + 1 or best.residuals_px.max() < _WRONG_PX:
        return None
    left = {}
    for number in np.argsort(best.residuals_px)[-_MOST_TRIED:].tolist():
        others = np.delete(directions, number, axis=0), np.delete(points, number, axis=0)
        left[number] = _cost(_minima(*others)[0], *others)
    suspect, second = sorted(left, key=lambda number: left[number])[:2]
    return suspect if left[second] > _WRONG_TIMES * left[suspect] else None


def _resection(camera: Camera, pose: Pose, pixels: Array, points: Array) -> Resection:
    off_px = residuals_px(camera, pose, pixels, points)
    _, slopes = _misfits(pose.rotation[None], pose.position[None], np.zeros_like(points), points)
    distances = np.linalg.norm(points - pose.position, axis=1)
    free = 2 * len(points) - 6
    click_px = max(CLICK_PX, float(np.sqrt(np.square(off_px).sum() / free)) if free > 0 else 0.0)
    spread = np.repeat(np.hypot(click_px / camera.fx_px, POINT_M / np.maximum(distances, 1e-3)), 3)
    weighed = slopes[0] / spread[:, None]
    covariance = np.linalg.pinv(weighed.T @ weighed)
    radius_m, radius_rad = (
        _RADIUS_68 * float(np.sqrt(np.trace(block))) for block in (covariance[:3, :3], covariance[3:, 3:])
    )
    axis = pose.rotation[2]
    tilt = np.arccos(np.clip(axis[2], -1, 1)) if camera.is_whole_sphere else abs(np.arctan2(axis[1], axis[2]))
    return Resection(pose, off_px, radius_m, float(np.degrees(radius_rad)), float(np.degrees(tilt)))


def _rms(found: Resection) -> float:
    return float(np.sqrt(np.square(found.residuals_px).mean()))
