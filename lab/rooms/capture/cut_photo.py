"""Photos cut out of a panorama: what a camera at the same place shows, resampled."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from core.camera.camera import Camera
from core.camera.pixel_rays import rays_of_pixels
from core.geometry.projection import project, sample_bilinear
from core.panorama.panorama import Panorama
from core.panorama.session import Photo

_SURELY_VALID = 0.999  # of the weights of the four pixels that one is mixed of


def cut_photo(panorama: Panorama, camera: Camera, panorama_from_camera: NDArray[np.float64]) -> Photo:
    """Return the photo that a camera turned by `panorama_from_camera` (3, 3) takes at the place of the panorama.

    A pixel is valid where the lens shows something and all that it is mixed of is valid. A panorama finer than the photo is averaged down
    first.
    """
    panorama = _no_finer(panorama, min(camera.fx_px, camera.fy_px))
    row, column = np.meshgrid(np.arange(camera.height_px) + 0.5, np.arange(camera.width_px) + 0.5, indexing="ij")
    directions, shown = rays_of_pixels(camera, column, row)
    height, width = panorama.valid.shape
    u, v = project(torch.from_numpy(np.nan_to_num(directions) @ panorama_from_camera.T), height, width)
    planes = np.concatenate((panorama.color, 255 * panorama.valid[..., None]), axis=-1).astype(np.float64)
    sampled = sample_bilinear(torch.from_numpy(planes).permute(2, 0, 1).contiguous(), u, v).numpy()
    valid = shown & (sampled[..., 3] > 255 * _SURELY_VALID)
    color = np.clip(sampled[..., :3] + 0.5, 0, 255).astype(np.uint8)
    return Photo(color * valid[..., None], valid, camera)


def _no_finer(panorama: Panorama, px_per_rad: float) -> Panorama:
    """Return the panorama, averaged down by a whole factor where it has several pixels to one of the photo."""
    height = len(panorama.valid)
    factor = int(height / math.pi / px_per_rad)
    if factor < 2:
        return panorama
    size = (2 * (height // factor), height // factor)
    color = np.asarray(Image.fromarray(panorama.color).resize(size, Image.Resampling.BOX))
    share = np.asarray(Image.fromarray(panorama.valid.astype(np.uint8) * 255).resize(size, Image.Resampling.BOX))
    return Panorama(color, share == 255)
