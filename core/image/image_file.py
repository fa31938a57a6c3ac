"""The pixels of an uploaded file: decoded, turned upright, brought to 8-bit RGB."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from PIL.ImageFile import ImageFile

from panoloc.core.errors import MaskShapeError, PanoramaTooLargeError
from panoloc.core.image.conversion import open_decodable
from panoloc.core.image.image_header import MASK, Upload
from panoloc.core.image.known_camera import Crop

MIN_HEIGHT = 64  # rows of a full sphere in which anything can be told apart
# Four bytes each in Pillow, and a dozen in what is computed of them.
_MOST_WHOLE_PIXELS = 1 << 25
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
# Photos and pictures of scans shrink to a half or a tenth; only what shrinks further is worth a look, which takes as long as decoding.
_USUAL_RATIO = 20
_PIECE_BYTES = 1 << 20


def decode(image: ImageFile, upload: Upload, turned: bool = True, factor: int = 1) -> Image.Image:
    """Return the pixels, `turned` as EXIF says or as they are stored. Raises the upload's `damaged_error`.

    factor: so much finer is the image than anything looks at. A JPEG is decoded at a half to an eighth of its size then, several times
    faster; of other images those that have more pixels than fit the budget are made as small afterwards.
    """
    if image.format == "JPEG" and factor > 1:
        image.draft("RGB", (max(1, image.width // factor), max(1, image.height // factor)))
    try:
        image.load()
        pixels = ImageOps.exif_transpose(image) if turned else image
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise upload.damaged_error(
            f"{upload.name}: the file ends early or is damaged ({error}); upload it again in full"
        ) from error
    step = next((each for each in (8, 4, 2) if each <= factor), 1)
    if step == 1 or pixels.width * pixels.height <= _MOST_WHOLE_PIXELS or pixels.mode.startswith("I;"):
        return pixels
    if pixels.mode in ("P", "PA", "1"):
        pixels = pixels.convert("RGBA" if "transparency" in pixels.info or pixels.mode == "PA" else "RGB")
    return pixels.reduce(step)


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
    data, image = open_decodable(data, MASK, max_pixels)
    check_png_rows(data, MASK)
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


def check_png_rows(data: bytes, upload: Upload) -> None:
    """Raise the upload's `damaged_error` when the rows of a PNG end before the last: Pillow fills up what is missing with black."""
    if not data.startswith(b"\x89PNG"):
        return
    width, height, depth, color_type = struct.unpack(">IIBB", data[16:26])
    expected = (
        width * height * depth * _PNG_CHANNELS.get(color_type, 1) // 8
    )  # a byte for each row, and what interlacing adds, aside
    compressed, at = [], 8
    while at + 8 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        if data[at + 4 : at + 8] == b"IDAT":
            compressed.append(data[at + 8 : at + 8 + length])
        at += 12 + length
    if expected <= _USUAL_RATIO * sum(map(len, compressed)):
        return
    found, unpacking = 0, zlib.decompressobj()
    try:
        for rows in compressed:
            waiting = rows
            while waiting and found < expected:
                found += len(unpacking.decompress(waiting, _PIECE_BYTES))
                waiting = unpacking.unconsumed_tail
    except zlib.error as error:
        raise upload.damaged_error(f"{upload.name}: its rows are damaged ({error}); export it again") from error
    if found < expected:
        raise upload.damaged_error(
            f"{upload.name}: {width:,} x {height:,} pixels take {expected:,} bytes, got {found:,}; the file ends early, send it "
            "again in full"
        )
