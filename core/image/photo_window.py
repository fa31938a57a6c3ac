"""A photo placed on the sphere: as a panorama in which everything that it does not show is masked, or on the window that it fills.

The pose of the panorama is that of the camera: the optical axis goes through the middle of both.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image, share_with_direction
from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Photo
from panoloc.core.errors import OptionsError, PanoramaUnusableError
from panoloc.core.image.image_on_sphere import (
    LARGEST_STEP,
    directions_of_grid,
    resized_image,
    sample_image,
    shrunk_image,
    small_sphere_directions,
    sphere_directions,
)

_MIN_ROWS, _MAX_ROWS = 256, 1024  # of the sphere; refinement looks no closer than at 512
_COARSEST_ROWS = 16  # windows begin and end at whole pixels of a sphere of so many rows
_EXTENT_ROWS = 128  # of the sphere on which the extent of a photo is looked for
_MIN_SIDE = 16  # pixels
_MIN_WITH_DIRECTION = 0.5  # of a photo; of real lenses nearly all of it has one
_MIN_SHARE = 0.001  # of the sphere; what shows less says nothing about where it was taken
FINEST_PX_PER_RAD = LARGEST_STEP * _MAX_ROWS / math.pi
"""Focal length, in pixels, beyond which nothing of a photo is lost when it is made smaller."""


def photo_on_sphere(color: NDArray[np.uint8], valid: NDArray[np.bool_], camera: Camera) -> Panorama:
    """Place a photo on the sphere.

    color: (h, w, 3) RGB; valid: (h, w), False where the photo is to be ignored. camera: of this photo or of a copy of another size.
    Raises OptionsError where the camera belongs to an image of another shape, and PanoramaUnusableError where next to nothing is visible.
    """
    camera = camera.resized(color.shape[1], color.shape[0])
    if camera.is_whole_sphere:
        return Panorama(color, valid) if color.shape[1] == 2 * color.shape[0] else _two_to_one(color, valid)
    rows = _rows_of_sphere(camera)
    color, valid, camera = shrunk_image(color, valid, camera, rows)
    u, v, shown = project_to_image(camera, sphere_directions(rows))
    sampled, seen = sample_image(color, valid, u, v, shown)
    _check_share(seen, camera)
    return Panorama(sampled, seen)


def _two_to_one(color: NDArray[np.uint8], valid: NDArray[np.bool_]) -> Panorama:
    """Return a full sphere that is a pixel off the shape of one."""
    rows = valid.shape[0]
    return Panorama(*resized_image(color, valid, (2 * rows, rows)))


def check_share(valid: NDArray[np.bool_], camera: Camera) -> None:
    """Raise PanoramaUnusableError where next to nothing of the sphere is visible in a photo with the valid pixels (h, w), and OptionsError
    where most of the photo has no direction."""
    with_direction = share_with_direction(camera)
    if with_direction < _MIN_WITH_DIRECTION:
        raise OptionsError(
            "distortion: expected coefficients that are valid for most of the image, got some that fold over and "
            f"leave {with_direction:.0%} of it a direction; check their order and signs, and that the intrinsics "
            "belong to this image"
        )
    u, v, shown = project_to_image(camera, small_sphere_directions(_MIN_ROWS))
    column, row = u[shown].astype(np.int64), v[shown].astype(np.int64)
    seen = shown.copy()
    seen[shown] = valid[np.minimum(row, valid.shape[0] - 1), np.minimum(column, valid.shape[1] - 1)]
    _check_share(seen, camera)
    # Last: of one that shows next to nothing of the sphere little is left when it is made smaller.
    if min(valid.shape) < _MIN_SIDE:
        raise PanoramaUnusableError(
            f"image: expected a photo of at least {_MIN_SIDE} pixels a side, got {valid.shape[1]} x {valid.shape[0]}"
        )


def _check_share(seen: NDArray[np.bool_], camera: Camera) -> None:
    rows = len(seen)
    share = float((seen * np.sin(np.pi * (np.arange(rows) + 0.5) / rows)[:, None]).mean() * np.pi / 2)
    if share < _MIN_SHARE:
        raise PanoramaUnusableError(
            f"image: expected a photo that shows at least {_MIN_SHARE:.1%} of the sphere, got {share:.2%} "
            f"({camera.hfov_deg:.1f} degrees across); check the intrinsics and the mask"
        )


def _rows_of_sphere(camera: Camera) -> int:
    """Return the rows (a power of two) of a sphere that is about as fine as the photo, within bounds."""
    return min(max(_nearest_power(camera), _MIN_ROWS), _MAX_ROWS)


def _nearest_power(camera: Camera) -> int:
    """Return the rows, a power of two, of the sphere that is about as fine as the image of a camera."""
    return int(max(2 ** round(math.log2(max(math.pi * min(camera.fx_px, camera.fy_px), 1.0))), _COARSEST_ROWS))


@dataclass(frozen=True)
class PhotoOnWindow:
    """A photo on the window that it fills of a sphere of `rows` rows: color (h, w, 3), seen (h, w); cone: half the
    opening angle around the optical axis that holds all of the photo, radians."""

    color: NDArray[np.uint8]
    seen: NDArray[np.bool_]
    rows: int
    first_row: int
    first_column: int
    cone: float


def photo_on_window(photo: Photo, max_rows: int, is_labels: bool) -> PhotoOnWindow:
    """Sample a photo on the window that it fills of a sphere of about its own resolution, `max_rows` at most."""
    rows = int(min(max(_nearest_power(photo.camera), _MIN_ROWS), max_rows))
    if photo.camera.is_whole_sphere:
        rows = min(_nearest_power(photo.camera), max_rows)
        color, valid = resized_image(photo.color, photo.valid, (2 * rows, rows), is_labels)
        return PhotoOnWindow(color, valid, rows, 0, 0, math.pi)
    shows = _shown(photo)
    row0, row1, column0, column1 = _extent(shows, rows)
    color, valid, camera = photo.color, photo.valid, photo.camera
    if not is_labels:  # of labels an average means nothing
        color, valid, camera = shrunk_image(color, valid, camera, rows)
    r, c = np.arange(row0, row1) + 0.5, np.arange(column0, column1) + 0.5
    u, v, shown = project_to_image(camera, directions_of_grid(r, c, rows))
    return PhotoOnWindow(*sample_image(color, valid, u, v, shown, nearest=is_labels), rows, row0, column0, _cone(shows))


def _extent(shown: NDArray[np.bool_], rows: int) -> tuple[int, int, int, int]:
    """Return first and last row, first and last column (exclusive) of what a photo fills on a sphere of `rows` rows.

    shown: as of `_shown`.
    """
    step = rows // _COARSEST_ROWS
    fine = _EXTENT_ROWS // _COARSEST_ROWS
    used_rows, used_columns = (np.flatnonzero(shown.any(axis)) for axis in (1, 0))
    # One pixel of the search for the extent may hide an edge.
    bounds = []
    for used, most in ((used_rows, _COARSEST_ROWS), (used_columns, 2 * _COARSEST_ROWS)):
        first = max(0, (int(used.min()) - 1) // fine) if len(used) else 0
        last = min(most, (int(used.max()) + 1) // fine + 1) if len(used) else most
        bounds += [first * step, last * step]
    return bounds[0], bounds[1], bounds[2], bounds[3]


def _shown(photo: Photo) -> NDArray[np.bool_]:
    """Return which pixels of a sphere of `_EXTENT_ROWS` rows a photo shows."""
    return project_to_image(photo.camera, small_sphere_directions(_EXTENT_ROWS))[2]


def _cone(shown: NDArray[np.bool_]) -> float:
    """Return half the opening angle, radians, of the cone around the optical axis that holds all of a photo; shown: as of `_shown`."""
    ahead = small_sphere_directions(_EXTENT_ROWS)[..., 0][shown]
    return math.pi if not len(ahead) else min(math.pi, math.acos(float(ahead.min())) + math.pi / _EXTENT_ROWS)
