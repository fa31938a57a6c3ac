"""Read a panorama from the bytes of a JPEG, PNG or WebP file: limits first, pixels later.

EXIF orientation is honoured. GPano crop fields place a cropped panorama in the full sphere; without them anything but 2:1 is an
error. An alpha channel or a separate mask marks pixels to ignore.
"""

import io
import re
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from core.errors import MaskShapeError, PanoramaDamagedError, PanoramaShapeError, PanoramaTooLargeError
from core.options import MAX_PIXELS
from core.panorama.image_header import IMAGE, KNOWN_FORMATS, MASK, Upload, check_image
from core.panorama.panorama import Panorama

_FORMATS = ("JPEG", "PNG", "WEBP")  # MPO files come through the JPEG reader
_MIN_HEIGHT = 64
_DRAFT_HEIGHT = 512  # nothing looks closer; a JPEG of twice this or more is decoded at a half, a quarter or an eighth


def read_panorama(data: bytes, mask: bytes | None = None, *, max_pixels: int = MAX_PIXELS) -> Panorama:
    """Decode a panorama.

    data: a JPEG, PNG or WebP file, 8 or 16 bit, 2:1 or with GPano crop fields. mask: an image of the same aspect ratio, non-zero = ignore.
    max_pixels: checked against the header before anything is decoded.
    Raises PanoramaFormatError, PanoramaTooLargeError, PanoramaDamagedError or PanoramaShapeError; for the mask their
    subclasses MaskFormatError, MaskTooLargeError, MaskDamagedError or MaskShapeError.
    """
    image = _open(data, IMAGE, max_pixels)
    crop = _crop_fields(image, data)
    full_size = image.size
    if _swaps_sides(image):
        full_size = (full_size[1], full_size[0])
    if crop is None:
        _check_aspect(full_size)
    if image.format in ("JPEG", "MPO"):
        scale = max(1, image.size[1] // _DRAFT_HEIGHT)
        image.draft("RGB", (image.size[0] // scale, image.size[1] // scale))
    pixels = _decode(image, IMAGE)
    if crop is None and pixels.size[0] != 2 * pixels.size[1]:  # a pixel off, or halved from an odd number of rows
        pixels = pixels.resize((2 * pixels.size[1], pixels.size[1]))
    color, valid = _color_and_alpha(pixels)
    if crop is not None:
        color, valid = _place_crop(color, valid, crop, max_pixels)
    if not valid.any():
        raise PanoramaShapeError(
            "image: expected visible pixels, got an alpha channel that hides all; export it without transparency"
        )
    if mask is not None:
        valid = valid & ~_read_mask(mask, valid.shape, max_pixels)
    if not valid.any():
        raise MaskShapeError(
            "mask: every pixel is masked, nothing is left to localize; check that non-zero mask pixels mean 'ignore'"
        )
    return Panorama(color, valid)


def _open(data: bytes, upload: Upload, max_pixels: int) -> Image.Image:
    check_image(data, upload, max_pixels)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            return Image.open(io.BytesIO(data), formats=_FORMATS)
    except Image.DecompressionBombError as error:  # Pillow's own limit, where the caller allows more than that
        raise upload.too_large_error(f"{upload.name}: expected fewer pixels ({error}); scale it down") from error
    except UnidentifiedImageError as error:
        raise upload.format_error(
            f"{upload.name}: expected a {KNOWN_FORMATS} image, got one whose header cannot be read; convert it again"
        ) from error
    except (OSError, SyntaxError, ValueError) as error:
        raise upload.damaged_error(f"{upload.name}: the file's header is damaged ({error}); export it again") from error


def _decode(image: Image.Image, upload: Upload) -> Image.Image:
    try:
        image.load()
        return ImageOps.exif_transpose(image)
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise upload.damaged_error(
            f"{upload.name}: the file ends early or is damaged ({error}); upload it again in full"
        ) from error


def _swaps_sides(image: Image.Image) -> bool:
    """Tell whether the EXIF orientation turns the image by a quarter; reading it decodes a PNG to its end."""
    try:
        return int(image.getexif().get(0x0112, 1)) >= 5
    except (OSError, SyntaxError, ValueError, TypeError, EOFError) as error:
        raise PanoramaDamagedError(
            f"image: the file ends early or is damaged ({error}); upload it again in full"
        ) from error


def _check_aspect(size: tuple[int, int]) -> None:
    width, height = size
    if abs(width - 2 * height) > max(2, 0.005 * width):
        raise PanoramaShapeError(
            f"image: expected a 2:1 equirectangular panorama, got {width} x {height} ({width / height:.2f}:1); "
            "export the full sphere, or keep the GPano crop fields of a partial one"
        )
    if height < _MIN_HEIGHT:
        raise PanoramaShapeError(
            f"image: expected at least {2 * _MIN_HEIGHT} x {_MIN_HEIGHT} pixels, got {width} x {height}"
        )


def _color_and_alpha(image: Image.Image) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return colours (h, w, 3) and validity (h, w); 16-bit grey is brought to 8 bit, palettes and CMYK to RGB."""
    valid = np.ones((image.size[1], image.size[0]), dtype=bool)
    if image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info:
        image = image.convert("RGBA")
        valid = np.asarray(image.getchannel("A")) >= 128
    if image.mode.startswith("I") or image.mode == "F":
        grey = np.asarray(image, dtype=np.float64)
        # Pillow keeps PNG's 16-bit grey in these modes; 8-bit grey never gets here.
        grey = np.clip(grey / 257, 0, 255).round().astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2), valid
    return np.asarray(image.convert("RGB")), valid


@dataclass(frozen=True)
class _Crop:
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


def _crop_fields(image: Image.Image, data: bytes) -> _Crop | None:
    """Return the GPano crop of an XMP packet, None when there is none or it covers the full sphere."""
    packet = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or _find_xmp(data)
    text = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else str(packet or "")
    values = {}
    for name, field in _CROP_FIELDS.items():
        match = re.search(rf"GPano:{field}\s*(?:=\s*[\"']|>)\s*(\d{{1,7}})", text)
        if match is None:
            return None
        values[name] = int(match[1])
    crop = _Crop(**values)
    if (crop.width, crop.height) == (crop.full_width, crop.full_height):
        return None
    fits = crop.left + crop.width <= crop.full_width and crop.top + crop.height <= crop.full_height
    if not fits or crop.full_width != 2 * crop.full_height or crop.width == 0 or crop.height == 0:
        raise PanoramaShapeError(f"image: its GPano crop fields contradict each other ({crop}); correct or remove them")
    return crop


def _find_xmp(data: bytes) -> bytes:
    start = data.find(b"<x:xmpmeta", 0, 200_000)
    end = data.find(b"</x:xmpmeta>", start)
    return data[start:end] if 0 <= start < end else b""


def _place_crop(
    color: NDArray[np.uint8], valid: NDArray[np.bool_], crop: _Crop, max_pixels: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Place a cropped panorama in the full sphere, at the resolution it was decoded in."""
    scale = color.shape[1] / crop.width
    height = max(_MIN_HEIGHT, round(crop.full_height * scale))
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


def _read_mask(data: bytes, shape: tuple[int, ...], max_pixels: int) -> NDArray[np.bool_]:
    """Return which pixels to ignore, resized to the panorama's shape (h, w)."""
    image = _open(data, MASK, max_pixels)
    width, height = image.size
    if abs(width * shape[0] - height * shape[1]) > 0.01 * width * shape[0]:
        raise MaskShapeError(
            f"mask: expected the aspect ratio of the image, {shape[1]} x {shape[0]}, got {width} x {height}; make it of the "
            "image's size"
        )
    decoded = _decode(image, MASK)
    grey = np.asarray(decoded.convert("RGB")).max(axis=2) > 0
    return np.asarray(Image.fromarray(grey).resize((shape[1], shape[0]), Image.Resampling.NEAREST))
