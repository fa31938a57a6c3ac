"""Photos placed on the sphere: as a panorama in which all that they do not show is masked, or on the window that one fills.

The pose of the panorama of one photo is that of its camera: the optical axis goes through the middle of both.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image, share_with_direction
from panoloc.core.camera.rig import Panorama, Photo, Rig
from panoloc.core.config import CONTRAST, RefinementConfig
from panoloc.core.errors import OptionsError, PanoramaUnusableError
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.kernels.library import call, has_kernels

FINEST_ROWS = RefinementConfig().finest_rows  # of the sphere on which photos are looked at
_LARGEST_STEP = 2.0  # pixels of the image to one of the sphere; more would skip some
EXTENT_ROWS = 128  # of the sphere on which the extent of a photo is looked for
_COARSEST_ROWS = CONTRAST.rows  # windows begin and end at whole pixels of the coarsest images that are made of photos
_MIN_WITH_DIRECTION = 0.5  # of a photo; of real lenses nearly all of it has one
_MIN_SHARE = 0.001  # of the sphere; what shows less says nothing about where it was taken
FINEST_PX_PER_RAD = _LARGEST_STEP * FINEST_ROWS / math.pi
"""Focal length, in pixels, beyond which nothing of a photo is lost when it is made smaller."""


def rig_on_sphere(rig: Rig, most_rows: int | None = None) -> Panorama:
    """Return one panorama of all images, as if all had been taken from one place; `Rig.session_from_rig` is its pose.

    Its axes are those of the session, its place is the middle of the cameras; where images overlap, the one whose middle is nearest is
    shown. It has the rows of the finest image, or `most_rows`. For pictures, and for whatever needs no more.
    """
    cameras = [photo.camera for photo in rig.photos]
    rows = max(each.height_px if each.is_whole_sphere else _rows_of(each, FINEST_ROWS) for each in cameras)
    rows = rows if most_rows is None else min(rows, most_rows)
    only = rig.photos[0]
    if (
        len(cameras) == 1
        and only.camera.is_whole_sphere
        and np.allclose(rig.images[0].session_from_camera.rotation, np.eye(3))
    ):
        return Panorama(*_resized(only.color, only.valid, (2 * rows, rows)), only.left_out)
    sphere = SphereWindow.of_sphere(rows).grid()
    color, valid = np.zeros(sphere.shape, np.uint8), np.zeros(sphere.shape[:2], np.bool_)
    best = np.full(valid.shape, -2.0)
    for image in rig.images:
        directions = sphere @ image.session_from_camera.rotation
        found, seen = _image_towards(image.photo, directions, rows)
        better = seen & (directions[..., 0] > best)
        color[better], valid[better], best[better] = found[better], True, directions[..., 0][better]
    return Panorama(color, valid, rig.left_out)


def check_share(photo: Photo) -> None:
    """Raise PanoramaUnusableError where next to nothing of the sphere is visible in a photo, and OptionsError where most of it has no
    direction."""
    camera, sides = photo.camera, photo.valid.shape
    with_direction = share_with_direction(camera)
    if with_direction < _MIN_WITH_DIRECTION:
        raise OptionsError(
            "distortion: expected coefficients that are valid for most of the image, got some that fold over and "
            f"leave {with_direction:.0%} of it a direction; check their order and signs, and that the intrinsics "
            "belong to this image"
        )
    u, v, shown = project_to_image(camera, _directions())
    at = (np.clip(each, 0, side - 1).astype(np.int64) for each, side in zip((v, u), sides, strict=True))
    share = share_of_sphere(shown & photo.valid[tuple(at)])
    if share < _MIN_SHARE:
        raise PanoramaUnusableError(
            f"image: expected a photo that shows at least {_MIN_SHARE:.1%} of the sphere, got {share:.2%} "
            f"({camera.hfov_deg:.1f} degrees across); check the intrinsics and the mask"
        )
    # Last: of one that shows next to nothing of the sphere little is left when it is made smaller.
    if min(sides) < _COARSEST_ROWS:
        raise PanoramaUnusableError(
            f"image: expected a photo of at least {_COARSEST_ROWS} pixels a side, got {sides[1]} x {sides[0]}"
        )


def shown_share(rig: Rig) -> float:
    """Return about the share of the sphere, 0..1, that the images of a rig show together, overlaps counted once."""
    turned = (_directions() @ image.session_from_camera.rotation for image in rig.images)
    shown = [project_to_image(photo.camera, each)[2] for photo, each in zip(rig.photos, turned, strict=True)]
    return share_of_sphere(np.any(shown, axis=0))


def share_of_sphere(seen: NDArray[np.bool_]) -> float:
    """Return the share of the sphere, 0..1, that the true pixels (H, 2H) of an image of it cover."""
    row = np.arange(len(seen)) + 0.5
    return float((seen * np.sin(np.pi * row / len(seen))[:, None]).mean() * np.pi / 2)


def _rows_of(camera: Camera, most: int) -> int:
    """Return the rows, a power of two and `most` at most, of the sphere that is about as fine as the image of a camera."""
    exponent = round(math.log2(max(math.pi * min(camera.fx_px, camera.fy_px), _COARSEST_ROWS)))
    return min(1 << exponent, most)


@cache
def _directions() -> NDArray[np.float64]:
    """Return the directions of the pixels of the sphere on which extents are looked for; not to be written to."""
    found = SphereWindow.of_sphere(EXTENT_ROWS).grid()
    found.flags.writeable = False
    return found


@dataclass(frozen=True)
class PhotoOnWindow:
    """A photo on the window that it fills of a sphere: color (h, w, 3), seen (h, w); cone: half the opening angle around the optical axis
    that holds all of the photo, radians."""

    color: NDArray[np.uint8]
    seen: NDArray[np.bool_]
    window: SphereWindow
    cone: float


def photo_on_window(photo: Photo, max_rows: int, is_labels: bool) -> PhotoOnWindow:
    """Sample a photo on the window that it fills of a sphere of about its own resolution, `max_rows` at most."""
    rows = _rows_of(photo.camera, max_rows)
    if photo.camera.is_whole_sphere:
        sphere = SphereWindow.of_sphere(rows)
        return PhotoOnWindow(*_resized(photo.color, photo.valid, (2 * rows, rows), is_labels), sphere, math.pi)
    shown = project_to_image(photo.camera, _directions())[2]
    window = _extent(shown).at(rows)
    ahead = _directions()[..., 0][shown]
    cone = math.pi if not len(ahead) else min(math.pi, math.acos(float(ahead.min())) + math.pi / EXTENT_ROWS)
    return PhotoOnWindow(*_image_towards(photo, window.grid(), rows, is_labels), window, cone)


def _extent(shown: NDArray[np.bool_]) -> SphereWindow:
    """Return the window that a photo fills which shows those pixels of the sphere of `EXTENT_ROWS` rows, on the coarsest one."""
    fine = EXTENT_ROWS // _COARSEST_ROWS
    bounds = []
    for axis, most in ((1, _COARSEST_ROWS), (0, 2 * _COARSEST_ROWS)):
        used = np.flatnonzero(shown.any(axis))
        # One pixel of the search for the extent may hide an edge.
        first = max(0, (int(used.min()) - 1) // fine) if len(used) else 0
        last = min(most, (int(used.max()) + 1) // fine + 1) if len(used) else most
        bounds.append((first, last - first))
    (row, height), (column, width) = bounds
    return SphereWindow(_COARSEST_ROWS, row, column, height, width)


def _image_towards(
    photo: Photo, directions: NDArray[np.float64], rows: int, is_labels: bool = False
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the colours (h, w, 3) that a photo shows in directions (h, w, 3), and where it shows them (h, w).

    rows: of a sphere as fine as the directions. A finer photo is averaged down first, so that no pixel is skipped; labels are picked.
    """
    color, valid, camera = photo.color, photo.valid, photo.camera
    factor = int(min(camera.fx_px, camera.fy_px) * math.pi / rows / _LARGEST_STEP)
    if factor > 1 and not is_labels:  # of labels an average means nothing
        size = max(1, color.shape[1] // factor), max(1, color.shape[0] // factor)
        (color, valid), camera = _resized(color, valid, size), camera.resized(*size)
    return _sampled(color, valid, *project_to_image(camera, directions), nearest=is_labels)


def _resized(
    color: NDArray[np.uint8], valid: NDArray[np.bool_], size: tuple[int, int], is_labels: bool = False
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return an image (h, w, 3) and its validity (h, w) at another `size`, width and height: averaged, or of labels picked."""
    if size == valid.shape[::-1]:
        return color, valid
    if is_labels:
        rows, columns = (np.arange(side) * given // side for side, given in zip(size[::-1], valid.shape, strict=True))
        return color[rows][:, columns], valid[rows][:, columns]
    if bool(valid.all()):
        return _averaged(color, size), np.ones(size[::-1], np.bool_)
    # Masked pixels must not bleed into their neighbours: their average is taken out again.
    share = _averaged(valid.astype(np.uint8) * 255, size).astype(np.float32) / 255
    mean = _averaged(color * valid[..., None], size).astype(np.float32)
    small = np.clip(mean / np.maximum(share, 1e-3)[..., None] + 0.5, 0, 255).astype(np.uint8)
    return small, share > 0.99


def _averaged(pixels: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return an image (h, w) or (h, w, 3) of `size`, its width and height, each pixel the average of those that it covers."""
    from PIL import Image  # only here: the benchmarks of the core run where Pillow is not

    factor = pixels.shape[1] // size[0]
    if pixels.shape[:2] == (factor * size[1], factor * size[0]):  # the same pixels, in a third of the time
        return np.asarray(Image.fromarray(pixels).reduce(factor))
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))


def _sampled(
    color: NDArray[np.uint8],
    valid: NDArray[np.bool_],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    shown: NDArray[np.bool_],
    nearest: bool = False,
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the colours (H, W, 3) at pixel coordinates (H, W) where `shown`, and where all that is mixed is valid (H, W).

    Bilinearly, or those of the nearest pixels, as labels need them.
    """
    height, width = valid.shape
    if nearest:
        at = np.clip(v.astype(np.int64), 0, height - 1), np.clip(u.astype(np.int64), 0, width - 1)
        return color[at] * shown[..., None], valid[at] & shown
    if has_kernels():
        picture, seen = np.empty((*u.shape, 3), np.uint8), np.empty(u.shape, np.bool_)
        call("sample_image", color, valid, height, width, u, v, shown, u.size, picture, seen)
        return picture, seen
    at_u, at_v = u[shown] - 0.5, v[shown] - 0.5
    left = np.clip(np.floor(at_u), 0, max(width - 2, 0)).astype(np.int64)
    top = np.clip(np.floor(at_v), 0, max(height - 2, 0)).astype(np.int64)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across = np.clip(at_u - left, 0, 1).astype(np.float32)[:, None]
    down = np.clip(at_v - top, 0, 1).astype(np.float32)[:, None]
    upper = color[top, left] * (1 - across) + color[top, right] * across
    lower = color[bottom, left] * (1 - across) + color[bottom, right] * across
    sampled = np.zeros((*u.shape, 3), np.uint8)
    sampled[shown] = (upper * (1 - down) + lower * down + 0.5).astype(np.uint8)
    seen = shown.copy()
    seen[shown] = valid[top, left] & valid[top, right] & valid[bottom, left] & valid[bottom, right]
    return sampled, seen
