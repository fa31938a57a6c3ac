"""Bytes that are no map index, or whose arrays do not describe the same points, starts and patches, are refused."""

import dataclasses
import json
import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from panoloc.core.describe.patch_descriptors import ViewDescriptors
from panoloc.core.errors import IndexFormatError
from panoloc.core.index.map_builder import build_map_index
from panoloc.core.index.map_codec import decode_map_index, encode_map_index
from panoloc.core.index.map_index import MapIndex
from panoloc.core.options import IndexOptions
from tests.core.painted_box import PaintedBox

PREFIX = struct.Struct("<4sHI")
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


def described(index: MapIndex, **changes: torch.Tensor) -> MapIndex:
    """Return the index with other descriptors, basis or weights of patches."""
    return dataclasses.replace(index, descriptors=dataclasses.replace(index.descriptors, **changes))


def with_fine(index: MapIndex, **changes: torch.Tensor) -> MapIndex:
    """Return the index with other arrays of its fine views."""
    return dataclasses.replace(index, fine_views=dataclasses.replace(index.fine_views, **changes))


Change = Callable[[MapIndex], MapIndex]
UNFIT: dict[str, Change] = {
    "positions": lambda index: dataclasses.replace(index, positions=index.positions[:, :2]),
    "colors": lambda index: dataclasses.replace(index, colors=index.colors[:-1]),
    "starts": lambda index: dataclasses.replace(index, starts=index.starts[:, :2].contiguous()),
    "leaf_sizes": lambda index: dataclasses.replace(index, leaf_sizes=index.leaf_sizes[:-1]),
    "descriptors": lambda index: described(index, values=index.descriptors.values[:-1]),
    "basis": lambda index: described(index, basis=index.descriptors.basis[:, :-1]),
    "patch_weights": lambda index: described(index, weights=index.descriptors.weights[:, :-1]),
    "sampled_shares": lambda index: dataclasses.replace(index, sampled_shares=index.sampled_shares[:-1]),
    "fine_steps": lambda index: with_fine(index, steps=index.fine_views.steps[:-1]),
    "fine_scale": lambda index: with_fine(index, scale=index.fine_views.scale[:-1]),
    "fine_basis": lambda index: with_fine(index, basis=index.fine_views.basis[:, :-1]),
    "fine_weights": lambda index: with_fine(index, weights=index.fine_views.weights[:, :-1]),
    "pictures": lambda index: with_fine(index, pictures=index.fine_views.pictures[:, :, :-1]),
    "pictures_seen": lambda index: with_fine(index, seen=index.fine_views.seen[:, :-1]),
    "origin_offset": lambda index: dataclasses.replace(index, origin_offset=index.origin_offset[:2]),
}


@pytest.mark.parametrize("name", UNFIT)
def test_an_array_that_does_not_fit_the_others_is_refused_by_its_name(index: MapIndex, name: str) -> None:
    with pytest.raises(IndexFormatError, match=rf"{name}: expected the shape \(.*\), got \(.*\)"):
        decode_map_index(encode_map_index(UNFIT[name](index)))


def test_an_index_without_a_start_is_refused(index: MapIndex) -> None:
    views = index.descriptors
    none = dataclasses.replace(
        index,
        starts=index.starts[:0],
        leaf_sizes=index.leaf_sizes[:0],
        sampled_shares=index.sampled_shares[:0],
        descriptors=ViewDescriptors(views.values[:0], views.basis, views.weights[:0]),
        fine_views=index.fine_views.take(torch.arange(0)),
    )
    with pytest.raises(IndexFormatError, match=f"expected points and starts, got {index.num_points} and 0"):
        decode_map_index(encode_map_index(none))


def rewritten(data: bytes, change: Callable[[dict[str, Any]], None], body: Callable[[bytes], bytes] = bytes) -> bytes:
    """Return the bytes with another header and other arrays, in a form that is otherwise whole."""
    magic, version, length = PREFIX.unpack_from(data)
    header = json.loads(data[PREFIX.size :][:length])
    change(header)
    text = json.dumps(header).encode()
    arrays = body(zlib.decompress(data[PREFIX.size + length :]))
    return PREFIX.pack(magic, version, len(text)) + text + zlib.compress(arrays)


def keep(_: dict[str, Any]) -> None:
    """Change nothing."""


def test_an_index_without_a_point_is_refused(data: bytes) -> None:
    sizes: list[int] = []

    def empty(header: dict[str, Any]) -> None:
        for entry in header["arrays"][:2]:
            sizes.append(int(np.prod(entry["shape"])))
            entry["shape"][-1] = 0

    assert [
        entry["name"] for entry in json.loads(data[PREFIX.size :][: PREFIX.unpack_from(data)[2]])["arrays"][:2]
    ] == [
        "positions",
        "colors",
    ]
    with pytest.raises(IndexFormatError, match="expected points and starts, got 0 and"):
        decode_map_index(rewritten(data, empty, lambda body: body[sum(sizes) :]))


@pytest.mark.parametrize("extra", [-1, 1, 100])
def test_more_or_fewer_bytes_than_the_arrays_take_are_refused(data: bytes, extra: int) -> None:
    def stretched(body: bytes) -> bytes:
        return body[:extra] if extra < 0 else body + bytes(extra)

    with pytest.raises(IndexFormatError, match="damaged"):
        decode_map_index(rewritten(data, keep, stretched))


@pytest.mark.parametrize("name", ["lower", "step", "origin_offset", "spacing", "num_points_read", "arrays"])
def test_a_header_that_leaves_something_out_is_refused(data: bytes, name: str) -> None:
    with pytest.raises(IndexFormatError, match="build it again from the scan"):
        decode_map_index(rewritten(data, lambda header: header.pop(name)))


@pytest.mark.parametrize("length", [0, 1, 9, 10, 30])
def test_bytes_that_end_early_are_refused(data: bytes, length: int) -> None:
    with pytest.raises(IndexFormatError, match="build it again from the scan"):
        decode_map_index(data[:length])


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
