"""PCD files: three encodings, packed and separate colours."""

import struct

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.pcd import decompress_lzf
from tests.core.scan.scan_files import (
    CLOUD,
    assert_same_points,
    axes_of,
    codes_of,
    packed_colors,
    pcd_body,
    pcd_header,
    read,
)

ENCODINGS = ["ascii", "binary", "binary_compressed"]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("kind", "name"), [("F", "rgb"), ("U", "rgb"), ("U", "rgba"), ("I", "rgba")])
def test_packed_colours_are_read(encoding: str, kind: str, name: str) -> None:
    words = packed_colors(CLOUD, alpha=0 if kind == "F" else 255)
    column = words.view({"F": np.float32, "U": np.uint32, "I": np.int32}[kind])
    start = pcd_header(len(CLOUD), f"x y z {name}", "4 4 4 4", f"F F F {kind}", encoding)
    assert_same_points(read("scan.pcd", start + pcd_body([*axes_of(CLOUD), column], encoding)))


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("dtype", "scale"), [("u1", 1), ("<u2", 257), ("<u2", 1), ("<f4", 1 / 255)])
def test_separate_colours_are_read_beside_other_fields(encoding: str, dtype: str, scale: float) -> None:
    colors = [(CLOUD.colors[:, axis].astype(float) * scale).astype(dtype) for axis in range(3)]
    kind, size = dtype[-2].upper(), dtype[-1]
    ring = np.arange(len(CLOUD), dtype="<u2")
    start = pcd_header(
        len(CLOUD), "ring r g b X Y Z", f"2 {size} {size} {size} 8 8 8", f"U {kind} {kind} {kind} F F F", encoding
    )
    assert_same_points(read("scan.pcd", start + pcd_body([ring, *colors, *axes_of(CLOUD, "<f8")], encoding)))


def test_fields_of_several_values_and_padding_are_passed_over() -> None:
    rows = np.zeros(len(CLOUD), [("p", "<f4", 3), ("pad", "u1", 4), ("h", "<f4", 33), ("c", "<u4"), ("pad2", "u1", 2)])
    rows["p"], rows["c"] = CLOUD.positions, packed_colors(CLOUD)
    start = pcd_header(
        len(CLOUD), "x y z _ fpfh rgb _", "4 4 4 1 4 4 1", "F F F U F U U", "binary", counts="1 1 1 4 33 1 2"
    )
    assert_same_points(read("scan.pcd", start + rows.tobytes()))


def test_a_whole_number_written_as_a_float_is_a_packed_colour() -> None:
    start = pcd_header(2, "x y z rgb", "4 4 4 4", "F F F F", "ascii")
    cloud = read("scan.pcd", start + b"0 0 0 4210752\n1 1 1 16711935\n")
    np.testing.assert_array_equal(cloud.colors, [[64, 64, 64], [255, 0, 255]])


def test_a_colour_that_text_lost_is_dropped_not_black() -> None:
    start = pcd_header(3, "x y z rgb", "4 4 4 4", "F F F F", "ascii")
    cloud = read("scan.pcd", start + b"0 0 0 4210752\n1 1 1 nan\n2 2 2 4210752\n")
    assert len(cloud) == 2
    assert codes_of(cloud) == ["non_finite_points"]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_cut_file_is_damaged(encoding: str) -> None:
    start = pcd_header(len(CLOUD), "x y z rgb", "4 4 4 4", "F F F U", encoding)
    body = pcd_body([*axes_of(CLOUD), packed_colors(CLOUD)], encoding)
    for kept in (0, 6, len(body) // 2, len(body) - 40):
        with pytest.raises(ScanDamagedError, match="truncated"):
            read("scan.pcd", start + body[:kept])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("POINTS 60", "POINTS 61", "POINTS is 61, but WIDTH x HEIGHT is 60 x 1"),
        ("POINTS 60", "POINTS -1", "positive whole number"),
        ("SIZE 4 4 4 4", "SIZE 4 4 4", "have 4, 3, 4 and 4 entries"),
        ("SIZE 4 4 4 4", "SIZE 4 4 4 3", "the type U3"),
        ("FIELDS x y z rgb", "FIELDS x y z x", "declared twice"),
        ("COUNT 1 1 1 1", "COUNT 1 1 1 99999999", "more than"),
        ("DATA binary", "DATA zipped", "expected ascii, binary, binary_compressed"),
        ("DATA binary", "DATE binary", "no DATA line"),
        ("TYPE F F F U", "SIZE 4 4 4 4", "stands twice"),
        ("SIZE 4 4 4 4", "SIZE 4 4 4 8", "packed colours must have the size 4"),
    ],
)
def test_a_header_that_contradicts_itself_is_damaged(old: str, new: str, said: str) -> None:
    start = pcd_header(len(CLOUD), "x y z rgb", "4 4 4 4", "F F F U", "binary").decode().replace(old, new)
    with pytest.raises(ScanDamagedError, match=said):
        read("scan.pcd", start.encode() + bytes(60 * 24))


def test_no_colour_or_no_coordinates_is_said() -> None:
    with pytest.raises(ScanContentError, match="no colour"):
        read("scan.pcd", pcd_header(2, "x y z i", "4 4 4 4", "F F F F", "binary") + bytes(32))
    with pytest.raises(ScanContentError, match="no x, y and z"):
        read("scan.pcd", pcd_header(2, "x y rgb i", "4 4 4 4", "F F F F", "binary") + bytes(32))


def test_a_decompression_bomb_is_refused() -> None:
    num_points = 100_000_000
    start = pcd_header(num_points, "x y z rgb", "4 4 4 4", "F F F U", "binary_compressed")
    with pytest.raises(ScanDamagedError, match="announces 1,600,000,000 in 1,000 bytes"):
        read("scan.pcd", start + struct.pack("<II", 1000, num_points * 16) + bytes(1000))


def compress_lzf(data: bytes) -> bytes:
    """A plain LZF encoder: a reference wherever the last three bytes came before, literals elsewhere."""
    output, literals, position = bytearray(), bytearray(), 0
    seen: dict[bytes, int] = {}

    def flush() -> None:
        for start in range(0, len(literals), 32):
            piece = literals[start : start + 32]
            output.extend([len(piece) - 1, *piece])
        literals.clear()

    while position < len(data):
        key = data[position : position + 3]
        earlier = seen.get(key)
        seen[key] = position
        if len(key) < 3 or earlier is None or position - earlier > 8191:
            literals.append(data[position])
            position += 1
            continue
        length = 3
        while length < 264 and position + length < len(data) and data[earlier + length] == data[position + length]:
            length += 1
        flush()
        distance, short = position - earlier - 1, length - 2
        first = [(short << 5) | (distance >> 8)] if short < 7 else [(7 << 5) | (distance >> 8), short - 7]
        output.extend([*first, distance & 255])
        position += length
    flush()
    return bytes(output)


def test_lzf_survives_its_own_encoder_and_refuses_damage() -> None:
    rng = np.random.default_rng(0)
    for data in (b"", b"abc", b"a" * 5000, bytes(rng.integers(0, 4, 3000, dtype=np.uint8)), rng.bytes(500)):
        compressed = compress_lzf(data)
        assert decompress_lzf(compressed, len(data)) == data
        with pytest.raises(ValueError):
            decompress_lzf(compressed + b"\x05abc", len(data))
    for damaged in (b"\x20", b"\xe0\x01", b"\x20\x05", b"\x01ab\x3f\xff"):
        with pytest.raises(ValueError):
            decompress_lzf(damaged, 100)
