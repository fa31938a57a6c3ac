"""Pictures as cameras take them, without the scene generator: smooth shading, texture and noise."""

import io
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.image.invalid_regions import find_missing

Pixels = NDArray[np.uint8]


class Found(NamedTuple):
    """What is not the place, and what is said of it."""

    missing: NDArray[np.bool_]
    words: tuple[str, ...]


def scenery(width: int = 1024, height: int = 512, seed: int = 0, noise: float = 2.0) -> Pixels:
    """Return a picture (H, W, 3) of large shaded patches with a fine texture, between 40 and 200."""
    rng = np.random.default_rng(seed)
    patches = Image.fromarray(rng.integers(50, 190, (8, 16, 3)).astype(np.uint8)).resize(
        (width, height), Image.Resampling.BICUBIC
    )
    texture = Image.fromarray(rng.integers(0, 255, (height // 4, width // 4)).astype(np.uint8)).resize((width, height))
    grain = rng.normal(0, noise, (height, width, 3)) + (np.asarray(texture, np.float64)[..., None] - 128) / 6
    return np.clip(np.asarray(patches) + grain, 40, 200).astype(np.uint8)


def as_jpeg(color: Pixels, quality: int = 85) -> Pixels:
    """Return the picture after compression."""
    buffer = io.BytesIO()
    Image.fromarray(color).save(buffer, "JPEG", quality=quality)
    return np.asarray(Image.open(buffer))


def find(color: Pixels, is_sphere: bool = True) -> Found:
    """Return what is found where every pixel counts."""
    return Found(*find_missing(color, np.ones(color.shape[:2], np.bool_), is_sphere))


def shares(found: Found, covered: NDArray[np.bool_]) -> tuple[float, float]:
    """Return which share of the defect was found, and which of the rest was lost, by pixels."""
    return float(found.missing[covered].mean()), float(found.missing[~covered].mean())
