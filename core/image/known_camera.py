"""Photos of which nothing says what camera took them, told by their first bytes, so that they are refused before they wait. Needs no numpy.

A file is refused here only where the reader would find nothing either: what is unclear is left to it.
"""

import struct
from collections.abc import Sequence

from panoloc.core.errors import PanoramaShapeError
from panoloc.core.image.image_header import numbered, read_image_header

_START_OF_SCAN = 0xDA
# Of EXIF data, of GPano fields, and of the orientation in an XMP packet.
_WORDS = (b"Exif\x00", b"GPano", b"Orientation")


def check_known_cameras(images: Sequence[bytes]) -> None:
    """Refuse JPEG files without EXIF data that are no full spheres and no parts of one. Raises PanoramaShapeError.

    images: without a camera that the caller describes, their headers checked.
    """
    for number, data in enumerate(images, 1):
        header = read_image_header(data)
        size = header.width, header.height
        if header.kind == "jpeg" and all(size) and not is_full_sphere(size) and _says_nothing(data):
            with numbered(number, len(images)):
                raise no_camera_error(size)


def is_full_sphere(size: tuple[int, int]) -> bool:
    """Tell whether an image of this size (width, height) can be a full sphere: 2:1, but for a little rounding."""
    width, height = size
    return abs(width - 2 * height) <= max(2, 0.005 * width)


def no_camera_error(size: tuple[int, int]) -> PanoramaShapeError:
    """Return the error for a photo of this size (width, height) that nothing says the camera of."""
    width, height = size
    return PanoramaShapeError(
        f"image: expected a 2:1 equirectangular panorama, got {width} x {height} ({width / height:.2f}:1) without "
        "camera data; for a panorama, export the full sphere, or keep the GPano crop fields of a partial one; for a "
        "photo, keep the EXIF data (focal length in 35 mm terms), or send options.cameras with a model and its "
        "intrinsics or hfov_deg (--hfov 69); for an unknown field of view, send bounds: hfov_range_deg (--hfov 45-90)"
    )


def cropped_error(size: tuple[int, int], taken: tuple[int, int]) -> PanoramaShapeError:
    """Return the error for a photo of this size (width, height) that was cut out of one of size `taken`, whose EXIF data it has."""
    return PanoramaShapeError(
        f"image: expected the photo as it was taken, {taken[0]} x {taken[1]} px by its EXIF data, got {size[0]} x "
        f"{size[1]} px of another shape, with unknown focal length and centre; send the whole photo, or "
        "options.cameras with the intrinsics of the crop (cx_px and cy_px give the centre); for a centred crop "
        "hfov_range_deg suffices (--hfov 45-90)"
    )


def perhaps_cropped(size: tuple[int, int], taken: tuple[int, int]) -> str:
    """Return what to say of a photo of this size (width, height) that may be a copy of one of size `taken`, or a part of it."""
    return (
        f"the EXIF data describe an image of {taken[0]} x {taken[1]} px, got {size[0]} x {size[1]}, which is assumed "
        "to be a resized copy of the whole photo; if it is a crop, the field of view differs: send the whole photo, "
        "or options.cameras"
    )


def _says_nothing(data: bytes) -> bool:
    """Tell whether a JPEG says neither how it was taken nor how it is turned before its pixels begin; False where that is unclear."""
    at = 2
    try:
        while (marker := data[at + 1]) != _START_OF_SCAN:
            # Fill bytes and markers without a length are rare before the pixels: left to the reader.
            if data[at] != 0xFF or marker < 0xC0 or marker == 0xFF or 0xD0 <= marker <= 0xD9:
                return False
            at += 2 + struct.unpack(">H", data[at + 2 : at + 4])[0]
    except (IndexError, struct.error):
        return False
    return not any(word in data[:at] for word in _WORDS)
