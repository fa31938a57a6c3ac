"""Sizes from headers, held against what Pillow writes."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from service.errors import UnknownImageError
from service.image_header import read_image_header

WRITERS = {
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


@given(
    st.binary(),
    st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"RIFF\0\0\0\0WEBPVP8 ", b"RIFF\0\0\0\0WEBPVP8X"]),
)
def test_any_bytes_have_a_size_or_are_no_image(data: bytes, head: bytes) -> None:
    try:
        header = read_image_header(head + data)
    except UnknownImageError:
        return
    assert header.width >= 0
    assert header.height >= 0


@pytest.mark.parametrize(("kind", "said"), [("GIF", "a GIF image"), ("BMP", "a BMP image"), ("TIFF", "a TIFF image")])
def test_other_images_are_called_by_their_names(kind: str, said: str) -> None:
    data = io.BytesIO()
    Image.new("RGB", (8, 4)).save(data, kind)
    with pytest.raises(UnknownImageError, match=said):
        read_image_header(data.getvalue())


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\x00\x00\x00\x1cftypheic\x00\x00", "a HEIC image or a video"),
        (b"BM is how this text begins", "text"),
        (b"\x01\x02\x03", "bytes that begin 01 02 03"),
    ],
)
def test_what_is_no_image_is_described(data: bytes, said: str) -> None:
    with pytest.raises(UnknownImageError, match=said):
        read_image_header(data)
