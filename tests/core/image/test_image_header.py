"""Uploads are opened without decoding them: their sizes are known, and bombs and other files are refused at once."""

import io
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from panoloc.core.errors import (
    CoreError,
    MaskTooLargeError,
    PanoramaDamagedError,
    PanoramaFormatError,
    PanoramaTooLargeError,
)
from panoloc.core.image.image_header import IMAGE, KIND_BYTES, MASK, image_kind, open_image, open_images
from panoloc.core.options import MAX_PIXELS
from tests.core.image.picture_files import encoded, png_bomb

WRITERS: dict[str, dict[str, Any]] = {
    "png": {"format": "PNG"},
    "jpeg": {"format": "JPEG"},
    "progressive jpeg": {"format": "JPEG", "progressive": True, "exif": Image.Exif().tobytes() + bytes(2000)},
    "webp": {"format": "WEBP"},
    "lossless webp": {"format": "WEBP", "lossless": True},
    "avif": {"format": "AVIF"},
    "webp with alpha": {"format": "WEBP", "mode": "RGBA"},
}


@pytest.mark.parametrize("name", WRITERS)
def test_the_size_is_that_of_the_image(name: str) -> None:
    options = dict(WRITERS[name])
    data = io.BytesIO()
    Image.new(options.pop("mode", "RGB"), (37, 18)).save(data, **options)
    assert open_image(data.getvalue(), IMAGE, MAX_PIXELS).size == (37, 18)
    assert image_kind(data.getvalue()[:KIND_BYTES]) == name.split()[-1].replace("alpha", "webp")


@given(
    st.binary(),
    st.sampled_from(
        [
            b"",
            b"\x89PNG\r\n\x1a\n",
            b"\xff\xd8\xff",
            b"RIFF\0\0\0\0WEBPVP8 ",
            b"RIFF\0\0\0\0WEBPVP8X",
            b"\0\0\0\x10ftypheic\0\0\0\0",
        ]
    ),
)
def test_any_bytes_have_a_size_or_are_no_image(data: bytes, head: bytes) -> None:
    try:
        image = open_image(head + data, IMAGE, MAX_PIXELS)
    except CoreError:
        return
    assert min(image.size) > 0


@given(st.sampled_from(list(WRITERS)), st.data())
def test_any_damage_to_a_header_leaves_a_size_or_an_error_with_a_name(name: str, draw: st.DataObject) -> None:
    options = dict(WRITERS[name])
    file = io.BytesIO()
    Image.new(options.pop("mode", "RGB"), (37, 18)).save(file, **options)
    data = bytearray(file.getvalue())
    for at in draw.draw(st.lists(st.integers(0, len(data) - 1), max_size=4)):
        data[at] = draw.draw(st.integers(0, 255))
    try:
        open_image(bytes(data[: draw.draw(st.integers(0, len(data)))]), IMAGE, MAX_PIXELS)
    except CoreError:
        return


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_a_file_that_ends_within_its_header_is_refused_and_told_so(kind: str) -> None:
    with pytest.raises(PanoramaDamagedError, match="ends within its header"):
        open_image(encoded(np.zeros((18, 37, 3), np.uint8), kind)[:20], IMAGE, MAX_PIXELS)


def test_files_that_claim_too_many_pixels_are_refused_before_they_take_memory_or_time() -> None:
    began = time.perf_counter()
    with pytest.raises(PanoramaTooLargeError, match="40,000 x 20,000"):
        open_image(png_bomb(40_000, 20_000), IMAGE, MAX_PIXELS)
    webp = b"RIFF\x1a\0\0\0WEBPVP8L\x0d\0\0\0\x2f\xff\xff\xff\x0f" + bytes(9)  # 16,384 pixels a side
    with pytest.raises(MaskTooLargeError, match=r"^mask: "):
        open_image(webp, MASK, MAX_PIXELS)
    small = encoded(np.zeros((20, 40, 3), np.uint8))
    with pytest.raises(PanoramaTooLargeError, match="all 3 files together, got 2,400"):
        open_images([small] * 3, IMAGE, 2000)
    with pytest.raises(PanoramaTooLargeError, match=r"\(image 2 of 2\)$"):
        open_images([small, png_bomb(40_000, 20_000)], IMAGE, MAX_PIXELS)
    assert time.perf_counter() - began < 1


@pytest.mark.parametrize(
    ("data", "said"),
    [
        *((encoded(np.zeros((4, 8, 3), np.uint8), kind), f"a {kind} image") for kind in ("GIF", "BMP", "TIFF")),
        (b"\x00\x00\x00\x18ftypisom\x00\x00\x02\x00isomiso2", "a video, or an image in another format"),
        (b"BM is how this text begins", "text"),
        (b"\x01\x02\x03", "bytes that begin 01 02 03"),
    ],
)
def test_other_images_and_what_is_no_image_are_called_by_their_names(data: bytes, said: str) -> None:
    with pytest.raises(PanoramaFormatError, match=said):
        open_image(data, IMAGE, MAX_PIXELS)
