"""Images of a camera sampled in directions around it."""

import math

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.lens import project_to_image
from panoloc.core.camera.rig import Photo

LARGEST_STEP = 2.0  # pixels of the image to one of the sphere; more would skip some


def image_towards(
    photo: Photo, directions: NDArray[np.float64], rows: int, is_labels: bool = False
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the colours (h, w, 3) that a photo shows in directions (h, w, 3), and where it shows them (h, w).

    rows: of a sphere as fine as the directions. A finer photo is averaged down first, so that no pixel is skipped; labels are picked.
    """
    color, valid, camera = photo.color, photo.valid, photo.camera
    factor = int(min(camera.fx_px, camera.fy_px) * math.pi / rows / LARGEST_STEP)
    if factor > 1 and not is_labels:  # of labels an average means nothing
        size = max(1, color.shape[1] // factor), max(1, color.shape[0] // factor)
        (color, valid), camera = resized_image(color, valid, size), camera.resized(*size)
    return _sampled(color, valid, *project_to_image(camera, directions), nearest=is_labels)


def resized_image(
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
