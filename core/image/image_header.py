"""Size and kind of an image from its first bytes, so that a bomb is refused before anything is decoded. Needs no numpy."""

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from panoloc.core.errors import (
    CoreError,
    MaskDamagedError,
    MaskFormatError,
    MaskTooLargeError,
    PanoramaDamagedError,
    PanoramaFormatError,
    PanoramaTooLargeError,
)

ImageKind = Literal["jpeg", "png", "webp"]
KNOWN_FORMATS = "JPEG, PNG or WebP"
KIND_BYTES = 16

_JPEG_SIZE_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE_MARKERS = frozenset({0x01, *range(0xD0, 0xD9)})


@dataclass(frozen=True)
class ImageHeader:
    """What an image says of itself. width, height: pixels as stored."""

    kind: ImageKind
    width: int
    height: int


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


def check_images(files: Sequence[bytes], upload: Upload, max_pixels: int) -> None:
    """Look at the headers of all files of one kind. Raises as `check_image` does, for more than `max_pixels` pixels together, too."""
    total = 0
    for number, data in enumerate(files, 1):
        with numbered(number, len(files)):
            header = check_image(data, upload, max_pixels)
        total += header.width * header.height
    if total > max_pixels:
        raise upload.too_large_error(
            f"{upload.name}: expected at most {max_pixels:,} pixels in all {len(files)} files together, got "
            f"{total:,}; scale them down (1920 x 1440 is enough for a frame), or send fewer"
        )


def check_image(data: bytes, upload: Upload, max_pixels: int) -> ImageHeader:
    """Return the header of an upload. Raises its `format_error`, or `too_large_error` for more than `max_pixels` pixels."""
    try:
        header = read_image_header(data)
    except PanoramaFormatError as error:
        raise upload.format_error(f"{upload.name}: {error}") from error
    if header.width * header.height > max_pixels:
        raise upload.too_large_error(
            f"{upload.name}: expected at most {max_pixels:,} pixels, got {header.width:,} x {header.height:,}; scale "
            "it down (4096 x 2048 is enough)"
        )
    return header


def image_kind(head: bytes) -> ImageKind | None:
    """Return which of the formats a file has, None for any other. head: its first `KIND_BYTES` bytes, or more."""
    if head.startswith(b"\x89PNG\r\n\x1a\n") and head[12:16] == b"IHDR":
        return "png"
    if head.startswith(b"\xff\xd8\xff"):
        return "jpeg"
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "webp"
    return None


def read_image_header(data: bytes) -> ImageHeader:
    """Return kind and size of a JPEG, PNG or WebP image. Raises PanoramaFormatError for anything else."""
    kind = image_kind(data)
    try:
        if kind == "png":
            return ImageHeader(kind, *struct.unpack(">II", data[16:24]))
        if kind == "jpeg":
            return _jpeg(data)
        if kind == "webp":
            return _webp(data)
    except (struct.error, IndexError) as error:
        raise PanoramaFormatError(
            f"expected an image, got one that ends within its header ({len(data):,} bytes); send the whole file"
        ) from error
    advice = "convert it to one of them" if data else "its content was not saved or not sent; check the file"
    if _is_text(data):
        advice = "send the content of the file, not its name (in curl, write @ before the name)"
    raise PanoramaFormatError(f"expected a {KNOWN_FORMATS} image, got {_description(data)}; {advice}")


def _jpeg(data: bytes) -> ImageHeader:
    at = 2
    while True:
        if data[at] != 0xFF:
            raise IndexError
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
        elif marker in _JPEG_BARE_MARKERS:
            at += 2
        elif marker in _JPEG_SIZE_MARKERS:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return ImageHeader("jpeg", width, height)
        else:
            (length,) = struct.unpack(">H", data[at + 2 : at + 4])
            at += 2 + length


def _webp(data: bytes) -> ImageHeader:
    chunk = data[12:16]
    if chunk == b"VP8X":
        low_width, high_width, low_height, high_height = struct.unpack("<HBHB", data[24:30])
        return ImageHeader("webp", 1 + (high_width << 16 | low_width), 1 + (high_height << 16 | low_height))
    if chunk == b"VP8L":
        (bits,) = struct.unpack("<I", data[21:25])
        return ImageHeader("webp", 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF))
    if chunk == b"VP8 ":
        width, height = struct.unpack("<HH", data[26:30])
        return ImageHeader("webp", width & 0x3FFF, height & 0x3FFF)
    raise IndexError


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
        return "a HEIC image or a video"
    named = (kind for beginning, kind in _OTHER_KINDS.items() if head.startswith(beginning))
    return next(named, f"bytes that begin {head.hex(' ')}")
