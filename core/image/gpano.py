"""GPano crop fields: which part of the full sphere an image is, as panorama apps write it into XMP."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.errors import PanoramaTooLargeError, PanoramaUnusableError

MIN_HEIGHT = 64  # rows of a full sphere in which anything can be told apart


@dataclass(frozen=True)
class Crop:
    """GPano crop fields in pixels of the full sphere."""

    full_width: int
    full_height: int
    left: int
    top: int
    width: int
    height: int


_CROP_FIELDS = {
    "full_width": "FullPanoWidthPixels",
    "full_height": "FullPanoHeightPixels",
    "left": "CroppedAreaLeftPixels",
    "top": "CroppedAreaTopPixels",
    "width": "CroppedAreaImageWidthPixels",
    "height": "CroppedAreaImageHeightPixels",
}


def crop_fields(image: Image.Image, data: bytes) -> Crop | None:
    """Return the GPano crop of an XMP packet, None when there is none or it covers the full sphere."""
    packet = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or _find_xmp(data)
    text = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else str(packet or "")
    values = {}
    for name, field in _CROP_FIELDS.items():
        match = re.search(rf"GPano:{field}\s*(?:=\s*[\"']|>)\s*(\d{{1,7}})", text)
        if match is None:
            return None
        values[name] = int(match[1])
    crop = Crop(**values)
    if (crop.width, crop.height) == (crop.full_width, crop.full_height):
        return None
    fits = crop.left + crop.width <= crop.full_width and crop.top + crop.height <= crop.full_height
    if not fits or crop.full_width != 2 * crop.full_height or crop.width == 0 or crop.height == 0:
        raise PanoramaUnusableError(
            f"image: its GPano crop fields contradict each other ({crop}); correct or remove them"
        )
    return crop


def _find_xmp(data: bytes) -> bytes:
    start = data.find(b"<x:xmpmeta", 0, 200_000)
    end = data.find(b"</x:xmpmeta>", start)
    return data[start:end] if 0 <= start < end else b""


def place_crop(
    color: NDArray[np.uint8], valid: NDArray[np.bool_], crop: Crop, max_pixels: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Place a cropped panorama in the full sphere, at the resolution it was decoded in."""
    scale = color.shape[1] / crop.width
    height = max(MIN_HEIGHT, round(crop.full_height * scale))
    if 2 * height * height > max_pixels:
        raise PanoramaTooLargeError(
            f"image: expected at most {max_pixels:,} pixels, got {2 * height:,} x {height:,} after placing the GPano crop; scale it down"
        )
    rows, columns = max(1, round(crop.height * scale)), max(1, round(crop.width * scale))
    resized = np.asarray(Image.fromarray(color).resize((columns, rows)))
    kept = np.asarray(Image.fromarray(valid).resize((columns, rows), Image.Resampling.NEAREST))
    top, left = min(round(crop.top * scale), height - rows), min(round(crop.left * scale), 2 * height - columns)
    full, mask = np.zeros((height, 2 * height, 3), np.uint8), np.zeros((height, 2 * height), bool)
    full[top : top + rows, left : left + columns] = resized
    mask[top : top + rows, left : left + columns] = kept
    return full, mask
