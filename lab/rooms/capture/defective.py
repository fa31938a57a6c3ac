"""A panorama with a defect of any kind, as it is stored after whatever drew it."""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from core.panorama.panorama import Panorama
from lab.rooms.capture.camera_look import encode_jpeg
from lab.rooms.capture.defects import DEFECT_KINDS, add_defect


def with_any_defect(panorama: Panorama, rng: np.random.Generator) -> tuple[Panorama, NDArray[np.bool_]]:
    """Draw one defect of all kinds over a panorama and compress it as a JPEG; return it, its mask untouched, and what is covered (H, W)."""
    drawn, covered = add_defect(panorama, DEFECT_KINDS[int(rng.integers(len(DEFECT_KINDS)))], rng)
    stored = encode_jpeg(drawn.color, int(rng.integers(75, 96)))
    return Panorama(np.asarray(Image.open(io.BytesIO(stored))), panorama.valid), covered
