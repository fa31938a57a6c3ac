"""The pixels of an uploaded file: opened with its header checked, decoded, turned upright, brought to 8-bit RGB."""

import io
import warnings

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from panoloc.core.errors import MaskShapeError, PanoramaDamagedError
from panoloc.core.image.image_header import KNOWN_FORMATS, MASK, Upload, check_image
from panoloc.core.image.png_rows import check_png_rows

# Four bytes each in Pillow, and a dozen in what is computed of them.
_MOST_WHOLE_PIXELS = 1 << 25
_QUARTER_TURNS = (5, 6, 7, 8)  # EXIF orientations; any other number than 1 to 8 says nothing
_FORMATS = ("JPEG", "PNG", "WEBP")  # MPO files come through the JPEG reader


def open_image(data: bytes, upload: Upload, max_pixels: int) -> Image.Image:
    """Open an upload without decoding it, its header checked. Raises its errors."""
    check_image(data, upload, max_pixels)
    check_png_rows(data, upload)
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


def decode(image: Image.Image, upload: Upload, turned: bool = True) -> Image.Image:
    """Return the pixels, `turned` as EXIF says or as they are stored. Raises the upload's `damaged_error`."""
    try:
        image.load()
        return ImageOps.exif_transpose(image) if turned else image
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise upload.damaged_error(
            f"{upload.name}: the file ends early or is damaged ({error}); upload it again in full"
        ) from error


def reduced(image: Image.Image, factor: int) -> Image.Image:
    """Return a decoded image that has more pixels than fit the budget at an eighth of its size or more, as a JPEG is decoded at once.

    factor: so much finer is it than anything looks at.
    """
    step = next((each for each in (8, 4, 2) if each <= factor), 1)
    if step == 1 or image.size[0] * image.size[1] <= _MOST_WHOLE_PIXELS:
        return image
    if image.mode in ("P", "PA", "1"):
        image = image.convert("RGBA" if "transparency" in image.info or image.mode == "PA" else "RGB")
    return image if image.mode.startswith("I;") else image.reduce(step)


def swaps_sides(image: Image.Image) -> bool:
    """Tell whether the EXIF orientation turns the image by a quarter; reading it decodes a PNG to its end."""
    try:
        return int(image.getexif().get(0x0112, 1)) in _QUARTER_TURNS
    except (OSError, SyntaxError, ValueError, TypeError, EOFError) as error:
        raise PanoramaDamagedError(
            f"image: the file ends early or is damaged ({error}); upload it again in full"
        ) from error


def color_and_alpha(image: Image.Image) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
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


def read_mask(data: bytes, shape: tuple[int, ...], max_pixels: int) -> NDArray[np.bool_]:
    """Return which pixels to ignore, resized to the panorama's shape (h, w)."""
    image = open_image(data, MASK, max_pixels)
    width, height = image.size
    if abs(width * shape[0] - height * shape[1]) > 0.01 * width * shape[0]:
        raise MaskShapeError(
            f"mask: expected the aspect ratio of the image, {shape[1]} x {shape[0]}, got {width} x {height}; give "
            "the mask the image's size"
        )
    # Smaller first: the colours of a hundred million pixels take gigabytes.
    decoded = decode(image, MASK).resize((shape[1], shape[0]), Image.Resampling.NEAREST)
    ignored: NDArray[np.bool_] = np.asarray(decoded.convert("RGB")).max(axis=2) > 0
    return ignored
