"""Read a panorama, or a photo of a known camera, from the bytes of its file: limits first, pixels later.

EXIF orientation is honoured. GPano crop fields place a cropped panorama in the full sphere. A photo is placed there by its camera: the one
that the caller describes, else a pinhole of the focal length that EXIF gives. Without any of these anything but 2:1 is an error. An
alpha channel or a separate mask marks pixels to ignore, and what is found not to be the place
(`panoloc.core.image.invalid_regions`) is ignored as well.
"""

import struct
import zlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from PIL.ImageFile import ImageFile

from panoloc.core.camera.camera import Camera, CameraDescription
from panoloc.core.camera.rig import Panorama, Photo, Rig
from panoloc.core.errors import MaskShapeError, PanoramaTooLargeError, PanoramaUnusableError
from panoloc.core.image.conversion import converted
from panoloc.core.image.heif_header import HEIF
from panoloc.core.image.image_header import IMAGE, MASK, Upload, open_image
from panoloc.core.image.invalid_regions import find_missing
from panoloc.core.image.known_camera import (
    Crop,
    described_for,
    known_camera,
    rounding_share,
    upright_size,
    words_of_copy,
)
from panoloc.core.image.photo_window import FINEST_PX_PER_RAD, FINEST_ROWS, check_share, rig_on_sphere
from panoloc.core.options import MAX_PIXELS

_MIN_HEIGHT = 64  # rows of a full sphere in which anything can be told apart
# Four bytes each in Pillow, and a dozen in what is computed of them.
_MOST_WHOLE_PIXELS = 1 << 25
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
# Photos and pictures of scans shrink to a half or a tenth; only what shrinks further is worth a look, which takes as long as decoding.
_USUAL_RATIO = 20
_PIECE_BYTES = 1 << 20


def read_panorama(
    data: bytes,
    mask: bytes | None = None,
    *,
    camera: CameraDescription | None = None,
    max_pixels: int = MAX_PIXELS,
) -> Panorama:
    """Decode a panorama, or a photo onto the sphere; arguments and errors as of `read_image`."""
    return rig_on_sphere(Rig.of_photo(read_image(data, mask, camera=camera, max_pixels=max_pixels)))


def read_image(
    data: bytes,
    mask: bytes | None = None,
    *,
    camera: CameraDescription | None = None,
    max_pixels: int = MAX_PIXELS,
) -> Photo:
    """Decode a photo of a known camera; a panorama is one of a camera that wraps.

    data: a file in one of `KNOWN_FORMATS`, 8 or 16 bit. mask: an image of the same aspect ratio, non-zero = ignore. camera: what took it;
    None: the file says so itself. max_pixels: checked against the header before anything is decoded.
    Raises PanoramaFormatError, PanoramaTooLargeError, PanoramaDamagedError, PanoramaShapeError or PanoramaUnusableError; for the mask the
    subclasses MaskFormatError, MaskTooLargeError, MaskDamagedError or MaskShapeError; OptionsError where camera and image do not fit.
    """
    data, image = _opened(data, IMAGE, max_pixels)
    size = upright_size(image)
    camera = described_for(image, data, camera)
    if camera is not None:
        photo = _photo(image, mask, camera.of_image(image.size, size), camera.is_as_stored(image.size), max_pixels)
        return replace(photo, hfov_range_deg=camera.hfov_range_deg, focal_uncertainty=camera.focal_uncertainty)
    crop = known_camera(image, data)
    if isinstance(crop, Camera):
        words = words_of_copy(image)
        photo = _photo(image, mask, crop, False, max_pixels)
        return replace(photo, focal_uncertainty=rounding_share(crop), left_out=(*photo.left_out, *words))
    if crop is None and size[1] < _MIN_HEIGHT:
        raise PanoramaUnusableError(
            f"image: expected at least {2 * _MIN_HEIGHT} x {_MIN_HEIGHT} pixels, got {size[0]} x {size[1]}"
        )
    factor = image.size[1] // (FINEST_ROWS // 2)  # nothing looks at a panorama as closely as at a photo
    pixels = _decode(image, IMAGE, factor=factor)
    if crop is None and pixels.size[0] != 2 * pixels.size[1]:  # a pixel off, or halved from an odd number of rows
        pixels = pixels.resize((2 * pixels.size[1], pixels.size[1]))
    color, valid = _color_and_alpha(pixels)
    if crop is not None:
        color, valid = _place_crop(color, valid, crop, max_pixels)
    return Photo.of_panorama(Panorama(color, *_counting(color, valid, mask, max_pixels, True)))


def _photo(image: ImageFile, mask: bytes | None, camera: Camera, as_stored: bool, max_pixels: int) -> Photo:
    """Decode a photo, no larger than it says anything."""
    factor = int(min(camera.fx_px, camera.fy_px) / FINEST_PX_PER_RAD)
    color, valid = _color_and_alpha(_decode(image, IMAGE, turned=not as_stored, factor=factor))
    camera = camera.resized(valid.shape[1], valid.shape[0])
    valid, left_out = _counting(color, valid, mask, max_pixels, camera.is_whole_sphere)
    photo = Photo(color, valid, camera, left_out)
    check_share(photo)
    return photo


def _counting(
    color: NDArray[np.uint8], opaque: NDArray[np.bool_], mask: bytes | None, max_pixels: int, is_sphere: bool
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Return which pixels (h, w) of an image show the place, and what the others are.

    opaque: what the image itself shows, mask or not: a caller's mask changes nothing about what is found.
    Raises PanoramaUnusableError or MaskShapeError where nothing is visible.
    """
    if not opaque.any():
        raise PanoramaUnusableError(
            "image: expected visible pixels, got an alpha channel that hides all pixels; export the image without "
            "transparency"
        )
    valid = opaque if mask is None else opaque & ~_ignored(mask, opaque.shape, max_pixels)
    if not valid.any():
        raise MaskShapeError(
            "mask: expected visible pixels, got a mask that hides all pixels; non-zero mask pixels mean 'ignore'"
        )
    missing, words = find_missing(color, opaque, is_sphere)
    shown = valid & ~missing
    # Where a mask leaves nothing else, what it leaves was meant.
    return (shown, words) if shown.any() else (valid, ())


def _opened(data: bytes, upload: Upload, max_pixels: int) -> tuple[bytes, ImageFile]:
    """Open an upload that can then be decoded, converted where it has to be; returns it with its bytes.

    Raises as `open_image`, `converted` and `_check_png_rows` do.
    """
    image = open_image(data, upload, max_pixels)
    if image.format == HEIF:
        data = converted(data, upload, max_pixels)
        image = open_image(data, upload, max_pixels)
    _check_png_rows(data, upload)
    return data, image


def _decode(image: ImageFile, upload: Upload, turned: bool = True, factor: int = 1) -> Image.Image:
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


def _ignored(data: bytes, shape: tuple[int, ...], max_pixels: int) -> NDArray[np.bool_]:
    """Return which pixels to ignore, resized to the panorama's shape (h, w)."""
    image = _opened(data, MASK, max_pixels)[1]
    width, height = image.size
    if abs(width * shape[0] - height * shape[1]) > 0.01 * width * shape[0]:
        raise MaskShapeError(
            f"mask: expected the aspect ratio of the image, {shape[1]} x {shape[0]}, got {width} x {height}; give "
            "the mask the image's size"
        )
    # Smaller first: the colours of a hundred million pixels take gigabytes.
    decoded = _decode(image, MASK).resize((shape[1], shape[0]), Image.Resampling.NEAREST)
    ignored: NDArray[np.bool_] = np.asarray(decoded.convert("RGB")).max(axis=2) > 0
    return ignored


def _place_crop(
    color: NDArray[np.uint8], valid: NDArray[np.bool_], crop: Crop, max_pixels: int
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


def _check_png_rows(data: bytes, upload: Upload) -> None:
    """Raise the upload's `damaged_error` when the rows of a PNG end before the last: Pillow fills up what is missing with black."""
    if not data.startswith(b"\x89PNG"):
        return
    width, height, depth, color_type = struct.unpack(">IIBB", data[16:26])
    # A byte for each row, and what interlacing adds, aside.
    expected = width * height * depth * _PNG_CHANNELS.get(color_type, 1) // 8
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
