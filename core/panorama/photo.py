"""A photo placed on the sphere: an equirectangular panorama in which everything that the photo does not show is masked.

The pose of the panorama is that of the camera: the optical axis goes through the middle of both.
"""

import math

import numpy as np
from numpy.typing import NDArray

from core.camera.camera import Camera
from core.camera.lens import project_to_image, share_with_direction
from core.errors import OptionsError, PanoramaUnusableError
from core.panorama.panorama import Panorama

_MIN_ROWS, _MAX_ROWS = 256, 1024  # of the sphere; refinement looks no closer than at 512
_MIN_SIDE = 16  # pixels
_MIN_WITH_DIRECTION = 0.5  # of a photo; of real lenses nearly all of it has one
_MIN_SHARE = 0.001  # of the sphere; what shows less says nothing about where it was taken
_LARGEST_STEP = 2.0  # pixels of the photo to one of the sphere; more would skip some
FINEST_PX_PER_RAD = _LARGEST_STEP * _MAX_ROWS / math.pi
"""Focal length, in pixels, beyond which nothing of a photo is lost when it is made smaller."""


def photo_on_sphere(color: NDArray[np.uint8], valid: NDArray[np.bool_], camera: Camera) -> Panorama:
    """Place a photo on the sphere.

    color: (h, w, 3) RGB; valid: (h, w), False where the photo is to be ignored. camera: of this photo or of a copy of another size.
    Raises OptionsError where the camera belongs to an image of another shape, and PanoramaUnusableError where next to nothing is visible.
    """
    camera = camera.resized(color.shape[1], color.shape[0])
    rows = _rows_of_sphere(camera)
    color, valid, camera = shrunk_photo(color, valid, camera, rows)
    u, v, shown = project_to_image(camera, _directions(rows))
    sampled, seen = sample_photo(color, valid, u, v, shown)
    _check_share(seen, camera)
    return Panorama(sampled, seen)


def check_share(valid: NDArray[np.bool_], camera: Camera) -> None:
    """Raise PanoramaUnusableError where next to nothing of the sphere is visible in a photo with the valid pixels (h, w), and OptionsError
    where most of the photo has no direction."""
    with_direction = share_with_direction(camera)
    if with_direction < _MIN_WITH_DIRECTION:
        raise OptionsError(
            f"distortion: expected coefficients that hold for most of the image, got some that turn back on themselves and leave "
            f"{with_direction:.0%} of it a direction; check their order and signs, and that the intrinsics belong to this image"
        )
    rows = _MIN_ROWS
    u, v, shown = project_to_image(camera, _directions(rows))
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
    wanted = math.pi * min(camera.fx_px, camera.fy_px)
    return int(min(max(2 ** round(math.log2(max(wanted, 1.0))), _MIN_ROWS), _MAX_ROWS))


def shrunk_photo(
    color: NDArray[np.uint8], valid: NDArray[np.bool_], camera: Camera, rows: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_], Camera]:
    """Average a photo (h, w, 3) down so that sampling it on a sphere of `rows` rows skips no pixel; the camera goes along."""
    factor = int(min(camera.fx_px, camera.fy_px) * math.pi / rows / _LARGEST_STEP)
    if factor < 2:
        return color, valid, camera
    size = max(1, color.shape[1] // factor), max(1, color.shape[0] // factor)
    if bool(valid.all()):
        return _averaged(color, size), np.ones(size[::-1], np.bool_), camera.resized(*size)
    # Masked pixels must not bleed into their neighbours: their average is taken out again.
    share = _averaged(valid.astype(np.uint8) * 255, size).astype(np.float32) / 255
    mean = _averaged(color * valid[..., None], size).astype(np.float32)
    small = np.clip(mean / np.maximum(share, 1e-3)[..., None] + 0.5, 0, 255).astype(np.uint8)
    return small, share > 0.99, camera.resized(*size)


def _averaged(pixels: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return an image (h, w) or (h, w, 3) of `size`, its width and height, each pixel the average of those that it covers."""
    from PIL import Image  # only here: the benchmarks of the core run where Pillow is not

    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))


def _directions(rows: int) -> NDArray[np.float64]:
    """Return the viewing directions (rows, 2 rows, 3) of the pixel centres of a sphere."""
    elevation = (np.pi / 2 - np.pi * (np.arange(rows) + 0.5) / rows)[:, None]
    azimuth = (np.pi - np.pi * (np.arange(2 * rows) + 0.5) / rows)[None]
    flat = np.cos(elevation)
    return np.stack(
        (flat * np.cos(azimuth), flat * np.sin(azimuth), np.broadcast_to(np.sin(elevation), (rows, 2 * rows))), axis=-1
    )


def sample_photo(
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
