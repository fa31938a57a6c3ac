"""Sizes from headers, held against what Pillow writes."""

import io
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from panoloc.core.errors import PanoramaFormatError
from panoloc.core.image.image_header import KIND_BYTES, image_kind, read_image_header
from tests.core.image.picture_files import encoded

WRITERS: dict[str, dict[str, Any]] = {
    "png": {"format": "PNG"},
    "jpeg": {"format": "JPEG"},
    "progressive jpeg": {"format": "JPEG", "progressive": True, "exif": Image.Exif().tobytes() + bytes(2000)},
    "webp": {"format": "WEBP"},
    "lossless webp": {"format": "WEBP", "lossless": True},
    "webp with alpha": {"format": "WEBP", "mode": "RGBA"},
}


@pytest.mark.parametrize("name", WRITERS)
def test_the_size_is_that_of_the_image(name: str) -> None:
    options = dict(WRITERS[name])
    data = io.BytesIO()
    Image.new(options.pop("mode", "RGB"), (37, 18)).save(data, **options)
    header = read_image_header(data.getvalue())
    assert (header.kind, header.width, header.height) == (name.split()[-1].replace("alpha", "webp"), 37, 18)
    assert image_kind(data.getvalue()[:KIND_BYTES]) == header.kind


@given(
    st.binary(),
    st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"RIFF\0\0\0\0WEBPVP8 ", b"RIFF\0\0\0\0WEBPVP8X"]),
)
def test_any_bytes_have_a_size_or_are_no_image(data: bytes, head: bytes) -> None:
    try:
        header = read_image_header(head + data)
    except PanoramaFormatError:
        return
    assert image_kind((head + data)[:KIND_BYTES]) == header.kind
    assert header.width >= 0
    assert header.height >= 0


@pytest.mark.parametrize(
    ("data", "said"),
    [
        *((encoded(np.zeros((4, 8, 3), np.uint8), kind), f"a {kind} image") for kind in ("GIF", "BMP", "TIFF")),
        (b"\x00\x00\x00\x1cftypheic\x00\x00", "a HEIC image or a video"),
        (b"BM is how this text begins", "text"),
        (b"\x01\x02\x03", "bytes that begin 01 02 03"),
    ],
)
def test_other_images_and_what_is_no_image_are_called_by_their_names(data: bytes, said: str) -> None:
    with pytest.raises(PanoramaFormatError, match=said):
        read_image_header(data)


# JPEG, marker by marker.


def segment(marker: int, content: bytes) -> bytes:
    return bytes((0xFF, marker)) + struct.pack(">H", len(content) + 2) + content


def frame(marker: int, width: int, height: int) -> bytes:
    """Return a segment that says the size of a picture with three channels."""
    return segment(marker, struct.pack(">BHHB", 8, height, width, 3) + bytes(9))


SOI, SIZE = b"\xff\xd8", (4096, 300)
NOT_THE_SIZE = frame(0xC0, 11, 7)


def jpeg_size(*parts: bytes) -> tuple[int, int]:
    header = read_image_header(SOI + b"".join(parts))
    assert header.kind == "jpeg"
    return header.width, header.height


@pytest.mark.parametrize("marker", sorted({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}))
def test_every_way_of_coding_a_jpeg_says_its_size(marker: int) -> None:
    assert jpeg_size(frame(marker, *SIZE)) == SIZE


@pytest.mark.parametrize("marker", [0xC4, 0xC8, 0xCC, 0xDB, 0xDD, 0xE0, 0xE1, 0xEF, 0xFE])
def test_tables_and_notes_of_a_jpeg_are_passed_over_whatever_they_hold(marker: int) -> None:
    assert jpeg_size(segment(marker, NOT_THE_SIZE), frame(0xC2, *SIZE)) == SIZE
    assert jpeg_size(segment(marker, bytes(65_533)), segment(marker, b""), frame(0xC0, *SIZE)) == SIZE


def test_markers_without_content_and_fill_bytes_of_a_jpeg_are_passed_over() -> None:
    bare = b"".join(bytes((0xFF, marker)) for marker in (0x01, *range(0xD0, 0xD9)))
    # The next two bytes, taken for a length, would lead to the wrong size.
    assert jpeg_size(segment(0xE0, b"JFIF"), bare, b"\xff" * 7, frame(0xC0, *SIZE), NOT_THE_SIZE) == SIZE


@pytest.mark.parametrize("rest", [b"\xff", b"\xff\xe0", b"\xff\xe0\x00", b"\xff\xe0\x00\x09", frame(0xC0, *SIZE)[:8]])
def test_a_jpeg_that_ends_before_its_size_is_refused(rest: bytes) -> None:
    with pytest.raises(PanoramaFormatError, match="ends within its header"):
        read_image_header(SOI + b"\xff" + rest)


# WebP and PNG, field by field.


def webp(kind: bytes, content: bytes) -> bytes:
    return b"RIFF" + struct.pack("<I", 12 + len(content)) + b"WEBP" + kind + struct.pack("<I", len(content)) + content


def lossless_webp(width: int, height: int, rest: int = 0) -> bytes:
    """Return a picture whose size takes 14 bits a side; rest: the four bits above, one for transparency, three for the version."""
    return webp(b"VP8L", b"\x2f" + struct.pack("<I", rest << 28 | (height - 1) << 14 | width - 1))


def lossy_webp(width: int, height: int, scale: int = 0) -> bytes:
    """Return a picture whose size takes 14 bits a side; scale: the two bits above, for whoever shows it."""
    return webp(b"VP8 ", bytes(3) + b"\x9d\x01\x2a" + struct.pack("<HH", scale << 14 | width, scale << 14 | height))


def extended_webp(width: int, height: int) -> bytes:
    """Return a picture whose size takes 24 bits a side."""
    sides = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    return webp(b"VP8X", b"\x10" + bytes(3) + sides)


@pytest.mark.parametrize(
    ("data", "size"),
    [
        (lossless_webp(1, 1), (1, 1)),
        (lossless_webp(16_384, 8192, rest=15), (16_384, 8192)),
        (lossless_webp(8192, 16_384), (8192, 16_384)),
        (lossless_webp(300, 7, rest=1), (300, 7)),
        (lossy_webp(16_383, 4097), (16_383, 4097)),
        (lossy_webp(4097, 16_383, scale=3), (4097, 16_383)),
        (lossy_webp(300, 7, scale=1), (300, 7)),
        (extended_webp(1, 1), (1, 1)),
        (extended_webp(70_000, 300), (70_000, 300)),
        (extended_webp(300, 16_777_216), (300, 16_777_216)),
    ],
)
def test_a_webp_says_its_size_in_one_of_three_ways(data: bytes, size: tuple[int, int]) -> None:
    header = read_image_header(data)
    assert (header.kind, header.width, header.height) == ("webp", *size)


def test_a_png_says_its_size_in_four_bytes_a_side() -> None:
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 70_000, 35_000)
    header = read_image_header(data)
    assert (header.kind, header.width, header.height) == ("png", 70_000, 35_000)
    with pytest.raises(PanoramaFormatError):
        read_image_header(data[:-1])
    with pytest.raises(PanoramaFormatError):
        read_image_header(data.replace(b"IHDR", b"IDAT"))
