"""What light and camera do to an image: exposure, white balance, gamma, tone curve, blur, noise, JPEG.

All steps work on the encoded (sRGB) values, as the paper's supplement does.
"""

import io
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from panoloc.core.camera.rig import Panorama, Photo


@dataclass(frozen=True)
class CameraLook:
    """A chain of changes in the order of the fields; the defaults change nothing.

    exposure: factor. white_balance: factor per channel. gamma: exponent on values in 0..1, above 1 darkens.
    contrast: strength of an S-curve around mid-grey, negative flattens. saturation: 0 grey, 1 unchanged.
    blur_px: standard deviation of a Gaussian, around the seam of a panorama. noise: standard deviation in 0..1.
    jpeg_quality: 1 to 95, None for no compression.
    """

    exposure: float = 1.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gamma: float = 1.0
    contrast: float = 0.0
    saturation: float = 1.0
    blur_px: float = 0.0
    noise: float = 0.0
    jpeg_quality: int | None = None


# The light changes of the paper's supplement, table 1.
DIM = CameraLook(exposure=0.67)
GAMMA_3 = CameraLook(gamma=3.0)
WHITE_BALANCE = CameraLook(white_balance=(1.0, 0.5, 0.5))
# What every photo suffers, whatever the light.
PHOTO = CameraLook(blur_px=0.4, noise=0.008, jpeg_quality=90)


def as_photo(look: CameraLook) -> CameraLook:
    """Return the look with the blur, noise and compression of an ordinary photo."""
    return replace(look, blur_px=PHOTO.blur_px, noise=PHOTO.noise, jpeg_quality=PHOTO.jpeg_quality)


def random_look(rng: np.random.Generator) -> CameraLook:
    """Draw another camera: exposure, white balance, tone curve, blur, noise and compression."""
    red, blue = rng.uniform(0.85, 1.15, 2)
    return CameraLook(
        exposure=rng.uniform(0.75, 1.2),
        white_balance=(red, 1.0, blue),
        gamma=rng.uniform(0.8, 1.3),
        contrast=rng.uniform(-0.2, 0.5),
        saturation=rng.uniform(0.75, 1.15),
        blur_px=rng.uniform(0.2, 0.8),
        noise=rng.uniform(0.004, 0.015),
        jpeg_quality=int(rng.integers(75, 94)),
    )


def apply_look(panorama: Panorama, look: CameraLook, seed: int = 0) -> Panorama:
    """Return the panorama as that camera in that light shows it; `seed` draws the noise. The mask stays."""
    return Panorama(looked(panorama.color, look, (seed,), "wrap"), panorama.valid)


def photo_with_look(photo: Photo, look: CameraLook, seed: tuple[int, ...]) -> Photo:
    """Return the photo as that camera in that light shows it; `seed` draws the noise. The mask stays."""
    return replace(photo, color=looked(photo.color, look, seed, "edge"))


def looked(
    pixels: NDArray[np.uint8], look: CameraLook, seed: tuple[int, ...], beyond: Literal["wrap", "edge"]
) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) as that camera in that light shows it; beyond: how it goes on at its sides, for the blur."""
    color = pixels.astype(np.float32) / 255 * (np.asarray(look.white_balance, np.float32) * look.exposure)
    color = np.clip(color, 0, 1) ** np.float32(look.gamma)
    color = _s_curve(color, look.contrast)
    grey = color.mean(-1, keepdims=True)
    color = grey + (color - grey) * np.float32(look.saturation)
    pixels = _bytes(color)
    if look.blur_px > 0:
        pixels = _blurred(pixels, look.blur_px, beyond)
    if look.noise > 0:
        grain = np.random.default_rng((*seed, 11)).normal(0, look.noise, color.shape).astype(np.float32)
        pixels = _bytes(pixels.astype(np.float32) / 255 + grain)
    if look.jpeg_quality is not None:
        pixels = np.asarray(Image.open(io.BytesIO(encode_jpeg(pixels, look.jpeg_quality))))
    return pixels


def encode_jpeg(pixels: NDArray[np.uint8], quality: int = 92) -> bytes:
    """Return (H, W, 3) uint8 as JPEG bytes."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=quality, subsampling=0 if quality > 90 else 2)
    return buffer.getvalue()


def _bytes(color: NDArray[np.float32]) -> NDArray[np.uint8]:
    return (np.clip(color, 0, 1) * 255 + 0.5).astype(np.uint8)


def _s_curve(color: NDArray[np.float32], strength: float) -> NDArray[np.float32]:
    smooth = color * color * (3 - 2 * color)
    return np.asarray(color + np.float32(strength) * (smooth - color), np.float32)


def _blurred(pixels: NDArray[np.uint8], radius_px: float, beyond: Literal["wrap", "edge"]) -> NDArray[np.uint8]:
    margin = int(np.ceil(4 * radius_px)) + 1
    padded = np.pad(pixels, ((0, 0), (margin, margin), (0, 0)), mode=beyond)
    blurred = np.asarray(Image.fromarray(padded).filter(ImageFilter.GaussianBlur(radius_px)))
    return np.ascontiguousarray(blurred[:, margin:-margin])
