"""Bytes that are no map index, or whose arrays do not describe the same points, starts and patches, are refused."""

import dataclasses
import json
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import zstandard

from panoloc.core.errors import IndexFormatError
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_codec import decode_map_index, encode_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import IndexOptions
from tests.core.painted_box import PaintedBox

PREFIX = struct.Struct("<4sHI")
ALL, SHORT = slice(None), slice(-1)
OFFSET = np.array([4_500_000.123456789, 5_400_000.987654321, 312.1])


@pytest.fixture(scope="module")
def index() -> MapIndex:
    """Return an index of a few points and starts."""
    return build_map_index(
        PaintedBox().scan(600, origin_offset=OFFSET), IndexOptions(starts_method="grid", spacing_m=2.0)
    )


@pytest.fixture(scope="module")
def data(index: MapIndex) -> bytes:
    return encode_map_index(index)


def test_survey_offsets_survive_to_the_last_bit(data: bytes) -> None:
    np.testing.assert_array_equal(decode_map_index(data).origin_offset, OFFSET)


# The name of an array, where it lies in the index, and what is cut off.
CUTS: dict[str, tuple[str, tuple[slice, ...]]] = {
    "positions": ("positions", (ALL, SHORT)),
    "colors": ("colors", (SHORT,)),
    "starts": ("starts", (ALL, SHORT)),
    "leaf_sizes": ("leaf_sizes", (SHORT,)),
    "sampled_shares": ("sampled_shares", (SHORT,)),
    "alias_starts": ("aliases.starts", (SHORT,)),
    "alias_turns": ("aliases.turns", (SHORT,)),
    "descriptors": ("views.steps", (SHORT,)),
    "descriptor_scale": ("views.scale", (SHORT,)),
    "basis": ("views.basis", (ALL, SHORT)),
    "patch_weights": ("views.weights", (ALL, SHORT)),
    "pictures": ("views.pictures", (ALL, ALL, SHORT)),
    "pictures_seen": ("views.seen", (ALL, SHORT)),
    "origin_offset": ("origin_offset", (SHORT,)),
}


def cut(index: Any, place: str, slices: tuple[slice, ...]) -> Any:
    """Return the index with a part of one of its arrays."""
    name, _, inner = place.partition(".")
    value = getattr(index, name)
    changed = cut(value, inner, slices) if inner else value[slices]
    if isinstance(changed, torch.Tensor):
        changed = changed.contiguous()
    return dataclasses.replace(index, **{name: changed})


@pytest.mark.parametrize("name", CUTS)
def test_an_array_that_does_not_fit_the_others_is_refused_by_its_name(index: MapIndex, name: str) -> None:
    with pytest.raises(IndexFormatError, match=rf"{name}: expected the shape \(.*\), got \(.*\)"):
        decode_map_index(encode_map_index(cut(index, *CUTS[name])))


def test_an_index_without_a_start_is_refused(index: MapIndex) -> None:
    nothing = torch.arange(0)
    none = dataclasses.replace(index, views=index.views.take(nothing), aliases=index.aliases.take(nothing))
    for place in ("starts", "leaf_sizes", "sampled_shares"):
        none = cut(none, place, (slice(0),))
    with pytest.raises(IndexFormatError, match=f"expected points and starts, got {index.num_points} and 0"):
        decode_map_index(encode_map_index(none))


def rewritten(data: bytes, change: Callable[[dict[str, Any]], None], body: Callable[[bytes], bytes] = bytes) -> bytes:
    """Return the bytes with another header and other arrays, in a form that is otherwise whole."""
    magic, version, length = PREFIX.unpack_from(data)
    header = json.loads(data[PREFIX.size :][:length])
    change(header)
    text = json.dumps(header).encode()
    arrays = body(zstandard.decompress(data[PREFIX.size + length :]))
    return PREFIX.pack(magic, version, len(text)) + text + zstandard.compress(arrays)


def test_an_index_without_a_point_is_refused(data: bytes) -> None:
    sizes: list[int] = []

    def empty(header: dict[str, Any]) -> None:
        for entry, name in zip(header["arrays"], ("positions", "colors"), strict=False):
            assert entry["name"] == name
            sizes.append(int(np.prod(entry["shape"])))
            entry["shape"][-1] = 0

    with pytest.raises(IndexFormatError, match="expected points and starts, got 0 and"):
        decode_map_index(rewritten(data, empty, lambda body: body[sum(sizes) :]))


@pytest.mark.parametrize("extra", [-1, 1, 100])
def test_more_or_fewer_bytes_than_the_arrays_take_are_refused(data: bytes, extra: int) -> None:
    def stretched(body: bytes) -> bytes:
        return body[:extra] if extra < 0 else body + bytes(extra)

    with pytest.raises(IndexFormatError, match="damaged"):
        decode_map_index(rewritten(data, lambda header: None, stretched))


@pytest.mark.parametrize("place", np.linspace(0, 1, 20, endpoint=False))
def test_a_bit_that_flipped_in_the_arrays_is_noticed(data: bytes, place: float) -> None:
    first = PREFIX.size + PREFIX.unpack_from(data)[2]
    damaged = bytearray(data)
    damaged[first + int(place * (len(data) - first))] ^= 1
    with pytest.raises(IndexFormatError, match="damaged"):
        decode_map_index(bytes(damaged))


@pytest.mark.parametrize(
    "name", ["lower", "step", "origin_offset", "spacing", "surface_thickness_m", "num_points_read", "arrays"]
)
def test_a_header_that_leaves_something_out_is_refused(data: bytes, name: str) -> None:
    with pytest.raises(IndexFormatError, match="build it again from the scan"):
        decode_map_index(rewritten(data, lambda header: header.pop(name)))


def test_another_version_and_other_bytes_are_told_from_damage(data: bytes) -> None:
    magic, version, length = PREFIX.unpack_from(data)
    for other in ((b"PLMJ", version), (magic, version + 1), (magic, version - 1)):
        with pytest.raises(IndexFormatError, match=f"expected version {version}, got"):
            decode_map_index(PREFIX.pack(*other, length) + data[PREFIX.size :])


def test_a_scan_wider_than_the_steps_reach_gets_coarser_steps_and_not_wrong_ones(index: MapIndex) -> None:
    far = index.positions.clone()
    far[0] = 3e8
    read = decode_map_index(encode_map_index(dataclasses.replace(index, positions=far, spacing=0.01)))
    assert float((read.positions - far).abs().max()) < 64  # float32 has no finer steps out there
    assert float((read.positions[1:] - far[1:]).abs().max()) < 1


def test_points_in_one_place_have_a_step_too(index: MapIndex) -> None:
    one_place = torch.full_like(index.positions, 2.5)
    read = decode_map_index(encode_map_index(dataclasses.replace(index, positions=one_place, spacing=0.0)))
    torch.testing.assert_close(read.positions, one_place)
