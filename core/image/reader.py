"""Read a panorama, or a photo of a known camera, from the bytes of its file: limits first, pixels later.

EXIF orientation is honoured. GPano crop fields place a cropped panorama in the full sphere. A photo is placed there by its camera: the one
that the caller describes, else a pinhole of the focal length that EXIF gives. Without any of these anything but 2:1 is an error. An
alpha channel or a separate mask marks pixels to ignore, and what is found not to be the place
(`panoloc.core.image.invalid_regions`) is ignored as well.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL.ImageFile import ImageFile

from panoloc.core.camera.camera import Camera, CameraDescription
from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Photo, Rig
from panoloc.core.errors import MaskShapeError, PanoramaUnusableError
from panoloc.core.image.conversion import open_decodable
from panoloc.core.image.image_file import (
    MIN_HEIGHT,
    check_png_rows,
    color_and_alpha,
    decode,
    place_crop,
    read_mask,
)
from panoloc.core.image.image_header import IMAGE
from panoloc.core.image.invalid_regions.finding import find_missing
from panoloc.core.image.known_camera import described_for, known_camera, rounding_share, upright_size, words_of_copy
from panoloc.core.image.photo_window import FINEST_PX_PER_RAD, FINEST_ROWS, check_share, rig_on_sphere
from panoloc.core.options import MAX_PIXELS


def read_panorama(
    data: bytes,
    mask: bytes | None = None,
    *,
    camera: CameraDescription | None = None,
    max_pixels: int = MAX_PIXELS,
) -> Panorama:
    """Decode a panorama, or a photo onto the sphere; arguments and errors as of `read_image`."""
    return rig_on_sphere(Rig.of_photo(read_image(data, mask, camera=camera, max_pixels=max_pixels)))[0]


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
    data, image = open_decodable(data, IMAGE, max_pixels)
    check_png_rows(data, IMAGE)
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
    if crop is None and size[1] < MIN_HEIGHT:
        raise PanoramaUnusableError(
            f"image: expected at least {2 * MIN_HEIGHT} x {MIN_HEIGHT} pixels, got {size[0]} x {size[1]}"
        )
    factor = image.size[1] // (FINEST_ROWS // 2)  # nothing looks at a panorama as closely as at a photo
    pixels = decode(image, IMAGE, factor=factor)
    if crop is None and pixels.size[0] != 2 * pixels.size[1]:  # a pixel off, or halved from an odd number of rows
        pixels = pixels.resize((2 * pixels.size[1], pixels.size[1]))
    color, valid = color_and_alpha(pixels)
    if crop is not None:
        color, valid = place_crop(color, valid, crop, max_pixels)
    return Photo.of_panorama(Panorama(color, *_counting(color, _masked(valid, mask, max_pixels), valid, True)))


def _photo(image: ImageFile, mask: bytes | None, camera: Camera, as_stored: bool, max_pixels: int) -> Photo:
    """Decode a photo, no larger than it says anything."""
    factor = int(min(camera.fx_px, camera.fy_px) / FINEST_PX_PER_RAD)
    color, valid = color_and_alpha(decode(image, IMAGE, turned=not as_stored, factor=factor))
    camera = camera.resized(valid.shape[1], valid.shape[0])
    valid, left_out = _counting(color, _masked(valid, mask, max_pixels), valid, camera.is_whole_sphere)
    photo = Photo(color, valid, camera, left_out)
    check_share(photo)
    return photo


def _masked(valid: NDArray[np.bool_], mask: bytes | None, max_pixels: int) -> NDArray[np.bool_]:
    """Return which pixels (h, w) count, without those of the mask. Raises PanoramaUnusableError or MaskShapeError where none does."""
    if not valid.any():
        raise PanoramaUnusableError(
            "image: expected visible pixels, got an alpha channel that hides all pixels; export the image without "
            "transparency"
        )
    if mask is not None:
        valid = valid & ~read_mask(mask, valid.shape, max_pixels)
    if not valid.any():
        raise MaskShapeError(
            "mask: expected visible pixels, got a mask that hides all pixels; non-zero mask pixels mean 'ignore'"
        )
    return valid


def _counting(
    color: NDArray[np.uint8], valid: NDArray[np.bool_], opaque: NDArray[np.bool_], is_sphere: bool
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Return which of the `valid` pixels (h, w) show the place, and what the others are.

    opaque: what the image itself shows, mask or not: a caller's mask changes nothing about what is found.
    """
    found = find_missing(color, opaque, is_sphere)
    shown = valid & ~found.missing
    # Where a mask leaves nothing else, what it leaves was meant.
    return (shown, found.words) if shown.any() else (valid, ())
