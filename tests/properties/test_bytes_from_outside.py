"""Whatever bytes come in, only errors of `core` come out."""

import contextlib
import json
import struct
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from panoloc.core.errors import CoreError, IndexFormatError, PanoramaError
from panoloc.core.image.reader import read_panorama
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_codec import decode_map_index, encode_map_index
from panoloc.core.options import IndexOptions
from tests.core.image.picture_files import encoded, gpano_packet
from tests.core.painted_box import PaintedBox


@cache
def tiny_index() -> bytes:
    """Return the bytes of a map index, which every process that shares the tests would build were it a constant."""
    cloud = PaintedBox(size_m=(2.0, 2.0, 2.0)).scan(2000)
    return encode_map_index(build_map_index(cloud, IndexOptions(starts_method="grid", spacing_m=1.0)))


NOISE, EXIF = np.random.default_rng(0).integers(0, 256, (64, 128, 3)).astype(np.uint8), Image.Exif()
EXIF[0x0112] = 3
PICTURES = {kind: encoded(NOISE, kind, exif=EXIF) for kind in ("JPEG", "PNG", "WEBP")}
changes = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=12)


def changed(data: bytes, edits: list[tuple[float, int]], reach: int) -> bytes:
    """Overwrite bytes at shares of the first `reach` bytes."""
    damaged = bytearray(data)
    for place, value in edits:
        damaged[int(place * min(reach, len(damaged)))] = value
    return bytes(damaged)


@given(st.binary(max_size=300))
def test_random_bytes_are_no_map_index(data: bytes) -> None:
    for attempt in (data, tiny_index()[:10] + data, tiny_index()[:4] + data):
        with pytest.raises(IndexFormatError):
            decode_map_index(attempt)


@given(st.deferred(lambda: st.integers(0, len(tiny_index()) - 1)))
def test_a_map_index_cut_short_is_refused(length: int) -> None:
    with pytest.raises(IndexFormatError):
        decode_map_index(tiny_index()[:length])


@pytest.mark.slow
@settings(max_examples=150)
@given(changes, st.sampled_from((12, 400, 1500, 10**9)))
def test_a_damaged_map_index_is_refused_or_still_an_index(edits: list[tuple[float, int]], reach: int) -> None:
    with contextlib.suppress(CoreError):
        decode_map_index(changed(tiny_index(), edits, reach))


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def with_header(header: Any) -> bytes:
    text = json.dumps(header).encode()
    index = tiny_index()
    length = struct.unpack_from("<I", index, 6)[0]
    return index[:6] + struct.pack("<I", len(text)) + text + index[10 + length :]


def own_header() -> dict[str, Any]:
    index = tiny_index()
    length = struct.unpack_from("<I", index, 6)[0]
    header: dict[str, Any] = json.loads(index[10 : 10 + length])
    return header


@pytest.mark.slow
@settings(max_examples=150)
@given(st.deferred(lambda: st.sampled_from(sorted(own_header()))), json_values)
def test_a_map_index_with_any_value_in_its_header_is_refused_or_still_an_index(field: str, value: Any) -> None:
    with contextlib.suppress(CoreError):
        decode_map_index(with_header(own_header() | {field: value}))


@pytest.mark.slow
@settings(max_examples=150)
@given(
    st.deferred(lambda: st.integers(0, len(own_header()["arrays"]) - 1)),
    st.sampled_from(("name", "dtype", "shape")),
    json_values | st.sampled_from(("<i8", "|O", "<M8[s]", "V3", "<f2")) | st.lists(st.integers(-3, 2**70), max_size=4),
)
def test_a_map_index_with_any_array_description_is_refused_or_still_an_index(
    number: int, field: str, value: Any
) -> None:
    header = own_header()
    header["arrays"][number][field] = value
    with contextlib.suppress(CoreError):
        decode_map_index(with_header(header))


def test_a_map_index_whose_header_nests_without_end_is_refused() -> None:
    text = b"[" * 200_000
    with pytest.raises(IndexFormatError):
        decode_map_index(tiny_index()[:6] + struct.pack("<I", len(text)) + text)


@given(st.binary(max_size=400))
def test_random_bytes_are_no_panorama(data: bytes) -> None:
    for attempt in (data, b"\x89PNG\r\n\x1a\n" + data, b"\xff\xd8\xff\xe0" + data, b"RIFF\x00\x01\x00\x00WEBP" + data):
        with pytest.raises(PanoramaError):
            read_panorama(attempt)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning:PIL.TiffImagePlugin")  # that EXIF data are damaged, as they are
@settings(max_examples=150)
@given(st.sampled_from(sorted(PICTURES)), changes, st.sampled_from((60, 250, 10**9)))
def test_a_damaged_picture_is_refused_or_still_a_picture(kind: str, edits: list[tuple[float, int]], reach: int) -> None:
    with contextlib.suppress(PanoramaError):
        read_panorama(changed(PICTURES[kind], edits, reach), max_pixels=1_000_000)


@given(st.lists(st.integers(0, 9_999_999) | st.sampled_from((0, 64, 128, 256)), min_size=6, max_size=6))
def test_any_crop_fields_are_honoured_within_the_pixel_limit_or_refused(values: list[int]) -> None:
    width, height, left, top, part_width, part_height = values
    packet = gpano_packet((width, height), (left, top), (part_width, part_height))
    data = encoded(np.full((64, 128, 3), (200, 10, 10), np.uint8), "JPEG", xmp=packet)
    try:
        panorama = read_panorama(data, max_pixels=1_000_000)
    except PanoramaError:
        return
    assert panorama.valid.size <= 1_000_000
