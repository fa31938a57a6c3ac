"""Panoramas of which nobody said what is missing: read as the service reads an upload, which may find it."""

import io

from PIL import Image

from core.panorama.panorama import Panorama
from core.panorama.reader import read_panorama


def as_uploaded(panorama: Panorama) -> Panorama:
    """Return the panorama as it is read from a file without a mask; what was already masked stays so."""
    buffer = io.BytesIO()
    Image.fromarray(panorama.color).save(buffer, "PNG")
    read = read_panorama(buffer.getvalue())
    return Panorama(read.color, read.valid & panorama.valid)
