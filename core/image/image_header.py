"""Uploads opened without decoding them, so that a bomb is refused by its header. Needs no numpy."""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from panoloc.core.errors import (
    CoreError,
    MaskDamagedError,
    MaskFormatError,
    MaskTooLargeError,
    PanoramaDamagedError,
    PanoramaFormatError,
    PanoramaTooLargeError,
)

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

ImageKind = Literal["jpeg", "png", "webp", "heic", "avif"]
KNOWN_FORMATS = "JPEG, PNG, WebP, HEIC or AVIF"
KIND_BYTES = 64
CONVERTED_KINDS: tuple[ImageKind, ...] = ("heic", "avif")
"""Formats that `panoloc.core.image.conversion` converts before anything reads them."""
_BRANDS: dict[ImageKind, frozenset[bytes]] = {
    "avif": frozenset({b"avif", b"avis"}),
    "heic": frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs"}),
}


@dataclass(frozen=True)
class Upload:
    """One of the two files of a query: its name in messages, and the errors by which callers know which one is at fault."""

    name: str
    format_error: type[PanoramaFormatError]
    damaged_error: type[PanoramaDamagedError]
    too_large_error: type[PanoramaTooLargeError]


IMAGE = Upload("image", PanoramaFormatError, PanoramaDamagedError, PanoramaTooLargeError)
MASK = Upload("mask", MaskFormatError, MaskDamagedError, MaskTooLargeError)


@contextmanager
def numbered(number: int, count: int) -> Iterator[None]:
    """Say in the message about one of several images which one it is, counted from 1."""
    try:
        yield
    except CoreError as error:
        raise error if count == 1 else type(error)(f"{error} (image {number} of {count})") from error


def open_images(files: Sequence[bytes], upload: Upload, max_pixels: int) -> list["ImageFile"]:
    """Open all files of one kind. Raises as `open_image` does, for more than `max_pixels` pixels together, too."""
    opened = []
    for number, data in enumerate(files, 1):
        with numbered(number, len(files)):
            opened.append(open_image(data, upload, max_pixels))
    total = sum(image.width * image.height for image in opened)
    if total > max_pixels:
        raise upload.too_large_error(
            f"{upload.name}: expected at most {max_pixels:,} pixels in all {len(files)} files together, got "
            f"{total:,}; scale them down (1920 x 1440 is enough for a frame), or send fewer"
        )
    return opened


def open_image(data: bytes, upload: Upload, max_pixels: int) -> "ImageFile":
    """Open an upload without decoding it; for the pixels of HEIC and AVIF see `panoloc.core.image.conversion`.

    Raises its `format_error` for no image, `damaged_error`, or `too_large_error` for more than `max_pixels` pixels.
    """
    # Commands load these only when they need them.
    from PIL.Image import DecompressionBombError
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile
    from PIL.WebPImagePlugin import WebPImageFile

    from panoloc.core.image.heif_header import HeifHeader

    readers: dict[ImageKind, type[ImageFile]] = {"jpeg": JpegImageFile, "png": PngImageFile, "webp": WebPImageFile}
    kind = image_kind(data)
    if kind is None:
        advice = "convert it to one of them" if data else "its content was not saved or not sent; check the file"
        if _is_text(data):
            advice = "send the content of the file, not its name (curl: write @ before the name)"
        raise upload.format_error(
            f"{upload.name}: expected a {KNOWN_FORMATS} image, got {_description(data)}; {advice}"
        )
    try:
        # Not `Image.open`, which has a limit of its own.
        image = readers.get(kind, HeifHeader)(io.BytesIO(data))
    except DecompressionBombError as error:  # of WebP
        raise upload.too_large_error(f"{upload.name}: expected fewer pixels ({error}); scale it down") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise upload.damaged_error(
            f"{upload.name}: expected a whole image, got one that ends within its header or is damaged there ({error}); "
            "send it again in full"
        ) from error
    if image.width * image.height > max_pixels:
        raise upload.too_large_error(
            f"{upload.name}: expected at most {max_pixels:,} pixels, got {image.width:,} x {image.height:,}; scale "
            "it down (4096 x 2048 is enough)"
        )
    return image


def image_kind(head: bytes) -> ImageKind | None:
    """Return which of the formats a file has, None for any other. head: its first `KIND_BYTES` bytes, or more."""
    if head.startswith(b"\x89PNG\r\n\x1a\n") and head[12:16] == b"IHDR":
        return "png"
    if head.startswith(b"\xff\xd8\xff"):
        return "jpeg"
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "webp"
    if head[4:8] == b"ftyp":
        # The major brand, its version, and all brands that the file is compatible with: photos of phones are all HEIC by one or the other.
        end = min(int.from_bytes(head[:4], "big"), len(head))
        brands = {head[8:12], *(head[at : at + 4] for at in range(16, end, 4))}
        return next((kind for kind, known in _BRANDS.items() if brands & known), None)
    return None


_OTHER_KINDS = {
    b"GIF8": "a GIF image",
    b"BM": "a BMP image",
    b"II*\x00": "a TIFF image",
    b"MM\x00*": "a TIFF image",
    b"%PDF": "a PDF document",
    b"PK\x03\x04": "a ZIP archive",
}


def _is_text(data: bytes) -> bool:
    return bool(data) and data[:12].isascii() and data[:12].decode().isprintable()


def _description(data: bytes) -> str:
    if not data:
        return "an empty file"
    head = data[:12]
    if _is_text(data):
        return f"text ({data[:80].decode(errors='replace')!r})"
    if head[4:8] == b"ftyp":
        return "a video, or an image in another format"
    named = (kind for beginning, kind in _OTHER_KINDS.items() if head.startswith(beginning))
    return next(named, f"bytes that begin {head.hex(' ')}")
