"""What a file says of the camera that took it: the focal length in 35 mm terms in EXIF, and GPano crop fields in XMP. Needs no numpy.

The equivalent is defined by the diagonal (CIPA DCG-001): 43.27 mm of film show as much as the diagonal of the image.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image
from PIL.ImageFile import ImageFile

from panoloc.core.camera.camera import Camera, CameraDescription, have_one_shape
from panoloc.core.errors import OptionsError, PanoramaDamagedError, PanoramaShapeError, PanoramaUnusableError
from panoloc.core.image.image_header import IMAGE, numbered, open_image

_EXIF_IFD, _ORIENTATION = 0x8769, 0x0112
_FOCAL_LENGTH_35MM = 0xA405
_SIZE_WHEN_TAKEN = 0xA002, 0xA003  # PixelXDimension and PixelYDimension
_QUARTER_TURNS = (5, 6, 7, 8)  # orientations; any other number than 1 to 8 says nothing
_FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
_ROUNDED_MM = 0.5  # at most, for the field holds whole millimetres
_PLAUSIBLE_MM = (4.0, 2000.0)
_END_OF_JPEG = b"\xff\xd9"  # among the pixels, which follow the header, no other byte follows ff than 00 and d0 to d7
_UNREADABLE = (OSError, SyntaxError, ValueError, TypeError, EOFError, ZeroDivisionError)


@dataclass(frozen=True)
class Crop:
    """GPano crop fields in pixels of the full sphere."""

    full_width: int
    full_height: int
    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True)
class ShownCamera:
    """The camera of an image as people see it: in the pixels of the whole file, turned upright.

    offset: where (px) the image begins in the camera's own: of a GPano crop, in the full sphere.
    """

    camera: Camera
    offset: tuple[int, int] = (0, 0)


def check_known_cameras(images: Sequence[ImageFile], files: Sequence[bytes]) -> None:
    """Refuse JPEG files that say nothing of their camera before they wait. Raises as `known_camera` does.

    images: opened, without a camera that the caller describes, each of the bytes of a file. Others are left to the reader: whether a PNG
    says more, only its end tells.
    """
    for number, (image, data) in enumerate(zip(images, files, strict=True), 1):
        if image.format == "JPEG":
            with numbered(number, len(images)):
                known_camera(image, data)


def described_for(image: ImageFile, data: bytes, described: CameraDescription | None) -> CameraDescription | None:
    """Return how a caller describes the camera of an image; None where the file says it. Raises as `crop_fields` and `upright_size` do."""
    if described is None or not described.unless_panorama:
        return described
    is_panorama = crop_fields(image, data) is not None or is_full_sphere(upright_size(image))
    return None if is_panorama else described


def known_camera(image: ImageFile, data: bytes) -> Camera | Crop | None:
    """Return the GPano crop of a panorama, or the pinhole camera that the EXIF data of a photo describe; None of a full sphere.

    data: the file. Raises as `crop_fields` and `upright_size` do, and PanoramaShapeError where the file says nothing of its camera;
    PanoramaDamagedError in place of that for a JPEG that ends early, which has lost more than that.
    """
    width, height = upright_size(image)
    crop = crop_fields(image, data)
    if crop is not None or is_full_sphere((width, height)):
        return crop
    (focal_mm,) = _numbers(image, _FOCAL_LENGTH_35MM)
    if _PLAUSIBLE_MM[0] <= focal_mm <= _PLAUSIBLE_MM[1]:  # false for NaN; writers put 0 for "unknown"
        focal_px = focal_mm * math.hypot(width, height) / _FILM_DIAGONAL_MM
        return Camera("pinhole", width, height, focal_px, focal_px, width / 2, height / 2)
    if image.format == "JPEG" and image.fp is not None and data.find(_END_OF_JPEG, image.fp.tell()) < 0:
        raise PanoramaDamagedError("image: the file ends early, before the end of its pixels; upload it again in full")
    raise PanoramaShapeError(
        f"image: expected a 2:1 equirectangular panorama, got {width} x {height} ({width / height:.2f}:1) without "
        "camera data; for a panorama, export the full sphere, or keep the GPano crop fields of a partial one; for a "
        "photo, keep the EXIF data (focal length in 35 mm terms), or send its camera (options.cameras): a model and its "
        "intrinsics, or its field of view (hfov_deg, --hfov 69), or bounds of that (hfov_range_deg, --hfov 45-90)"
    )


def shown_camera(data: bytes, described: CameraDescription | None, max_pixels: int) -> ShownCamera:
    """Return the camera of a file as `panoloc.core.image.reader.read_image` would find it; decodes nothing.

    Raises as that does for what is no image or says nothing of its camera, and OptionsError for a photo that is stored turned with a camera
    that is described as it is stored.
    """
    image = open_image(data, IMAGE, max_pixels)
    size = upright_size(image)
    described = described_for(image, data, described)
    if described is not None:
        if described.is_as_stored(image.size) and size != image.size:
            raise OptionsError(
                f"pairs: expected a camera described as its image is seen, {size[0]} x {size[1]} px, got one of the image as it is stored, "
                f"{image.width} x {image.height} px; place the photo by a rough pose instead"
            )
        return ShownCamera(described.of_image(image.size, size))
    found = known_camera(image, data)
    if isinstance(found, Camera):
        return ShownCamera(found)
    if isinstance(found, Crop):
        return ShownCamera(_sphere(found.full_width, found.full_height), (found.left, found.top))
    return ShownCamera(_sphere(*size))


def _sphere(width: int, height: int) -> Camera:
    return Camera("equirectangular", width, height, width / (2 * math.pi), height / math.pi, width / 2, height / 2)


def upright_size(image: Image.Image) -> tuple[int, int]:
    """Return width and height as the EXIF orientation turns them; reading it decodes a PNG to its end. Raises PanoramaDamagedError."""
    try:
        is_turned = int(image.getexif().get(_ORIENTATION, 1)) in _QUARTER_TURNS
    except _UNREADABLE as error:
        raise PanoramaDamagedError(
            f"image: the file ends early or is damaged ({error}); upload it again in full"
        ) from error
    return image.size[::-1] if is_turned else image.size


def is_full_sphere(size: tuple[int, int]) -> bool:
    """Tell whether an image of this size (width, height) can be a full sphere: 2:1, but for a little rounding."""
    width, height = size
    return abs(width - 2 * height) <= max(2, 0.005 * width)


def rounding_share(camera: Camera) -> float:
    """Return by which share of itself the focal length of a camera that EXIF data described may be off in 68 of 100 photos.

    What was rounded away is as likely to be much as little: 0.34 mm cover 68 %, of the 26 mm of a phone 1.3 %.
    """
    focal_mm = camera.fx_px * _FILM_DIAGONAL_MM / math.hypot(camera.width_px, camera.height_px)
    return 0.68 * _ROUNDED_MM / focal_mm


def words_of_copy(image: Image.Image) -> tuple[str, ...]:
    """Return what to say of a photo that has another size than its EXIF data say, and so may be a copy or a part of another.

    Raises PanoramaShapeError where it has another shape, for then it is a part.
    """
    width, height = map(int, _numbers(image, *_SIZE_WHEN_TAKEN))
    if width <= 0 or height <= 0:
        return ()
    # Some turn the pixels and leave the numbers.
    taken = (height, width) if have_one_shape((height, width), image.size) else (width, height)
    if not have_one_shape(taken, image.size):
        raise PanoramaShapeError(
            f"image: expected the photo as it was taken, {taken[0]} x {taken[1]} px by its EXIF data, got {image.width} x "
            f"{image.height} px of another shape, with unknown focal length and centre; send the whole photo, or "
            "the camera of the crop (options.cameras) with its intrinsics and centre (cx_px, cy_px); for a centred crop "
            "bounds of its field of view suffice (hfov_range_deg, --hfov 45-90)"
        )
    if taken == image.size:
        return ()
    return (
        f"the EXIF data describe an image of {taken[0]} x {taken[1]} px, got {image.width} x {image.height}, which is assumed "
        "to be a resized copy of the whole photo; if it is a crop, the field of view differs: send the whole photo, "
        "or options.cameras",
    )


def _numbers(image: Image.Image, *fields: int) -> list[float]:
    """Return fields of the EXIF data of a photo; 0 for what is missing, damaged or no finite number."""
    try:
        written = image.getexif().get_ifd(_EXIF_IFD)
        numbers = [float(written.get(field, 0)) for field in fields]
    except _UNREADABLE:
        return [0.0] * len(fields)
    return [number if math.isfinite(number) else 0.0 for number in numbers]


_CROP_FIELDS = (  # in the order of `Crop`
    *("FullPanoWidthPixels", "FullPanoHeightPixels", "CroppedAreaLeftPixels", "CroppedAreaTopPixels"),
    *("CroppedAreaImageWidthPixels", "CroppedAreaImageHeightPixels"),
)


def crop_fields(image: Image.Image, data: bytes) -> Crop | None:
    """Return the GPano crop of an XMP packet, None when there is none or it covers the full sphere.

    data: the file. Raises PanoramaUnusableError for fields that contradict each other.
    """
    packet = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or _find_xmp(data)
    text = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else str(packet or "")
    written = [re.search(rf"GPano:{field}\s*(?:=\s*[\"']|>)\s*(\d{{1,7}})", text) for field in _CROP_FIELDS]
    values = [int(match[1]) for match in written if match is not None]
    if len(values) < len(written):
        return None
    crop = Crop(*values)
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
