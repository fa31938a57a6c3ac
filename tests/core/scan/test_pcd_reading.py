"""PCD files: three encodings, packed and separate colours."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.pcd import decompress_lzf
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan

ScanFile = Callable[[str, bytes | str], Path]
Compare = Callable[..., None]
ENCODINGS = ["ascii", "binary", "binary_compressed"]


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


def pcd_header(num_points: int, fields: str, sizes: str, types: str, encoding: str, counts: str = "") -> bytes:
    counts = counts or " ".join("1" for _ in fields.split())
    return (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\n"
        f"COUNT {counts}\nWIDTH {num_points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {num_points}\nDATA {encoding}\n"
    ).encode()


def packed_colors(cloud: PointCloud, alpha: int = 0) -> NDArray[np.uint32]:
    red, green, blue = cloud.colors.T.astype(np.uint32)
    packed: NDArray[np.uint32] = np.uint32(alpha << 24) | (red << 16) | (green << 8) | blue
    return packed


def pcd_body(columns: list[NDArray[Any]], encoding: str) -> bytes:
    if encoding == "ascii":
        rows = zip(*[column.tolist() for column in columns], strict=True)
        return "\n".join(" ".join(repr(value) for value in row) for row in rows).encode()
    if encoding == "binary":
        rows_array = np.empty(len(columns[0]), [(str(number), c.dtype) for number, c in enumerate(columns)])
        for number, column in enumerate(columns):
            rows_array[str(number)] = column
        return rows_array.tobytes()
    data = b"".join(column.tobytes() for column in columns)
    compressed = compress_lzf(data)
    return struct.pack("<II", len(compressed), len(data)) + compressed


def axes(cloud: PointCloud, dtype: str = "<f4") -> list[NDArray[Any]]:
    return [np.ascontiguousarray(cloud.positions[:, axis], dtype) for axis in range(3)]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("kind", "name"), [("F", "rgb"), ("U", "rgb"), ("U", "rgba"), ("I", "rgba")])
def test_packed_colours_are_read(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, encoding: str, kind: str, name: str
) -> None:
    words = packed_colors(cloud, alpha=0 if kind == "F" else 255)
    column = words.view({"F": np.float32, "U": np.uint32, "I": np.int32}[kind])
    start = pcd_header(len(cloud), f"x y z {name}", "4 4 4 4", f"F F F {kind}", encoding)
    path = scan_file("scan.pcd", start + pcd_body([*axes(cloud), column], encoding))
    assert_same_points(read_scan(path), cloud)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("dtype", "scale"), [("u1", 1), ("<u2", 257), ("<u2", 1), ("<f4", 1 / 255)])
def test_separate_colours_are_read_beside_other_fields(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, encoding: str, dtype: str, scale: float
) -> None:
    colors = [(cloud.colors[:, axis].astype(float) * scale).astype(dtype) for axis in range(3)]
    kind, size = dtype[-2].upper(), dtype[-1]
    ring = np.arange(len(cloud), dtype="<u2")
    start = pcd_header(
        len(cloud), "ring r g b X Y Z", f"2 {size} {size} {size} 8 8 8", f"U {kind} {kind} {kind} F F F", encoding
    )
    path = scan_file("scan.pcd", start + pcd_body([ring, *colors, *axes(cloud, "<f8")], encoding))
    assert_same_points(read_scan(path), cloud)


def test_fields_of_several_values_and_padding_are_passed_over(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare
) -> None:
    rows = np.zeros(len(cloud), [("p", "<f4", 3), ("pad", "u1", 4), ("h", "<f4", 33), ("c", "<u4"), ("pad2", "u1", 2)])
    rows["p"], rows["c"] = cloud.positions, packed_colors(cloud)
    start = pcd_header(
        len(cloud), "x y z _ fpfh rgb _", "4 4 4 1 4 4 1", "F F F U F U U", "binary", counts="1 1 1 4 33 1 2"
    )
    assert_same_points(read_scan(scan_file("scan.pcd", start + rows.tobytes())), cloud)


def test_a_whole_number_written_as_a_float_is_a_packed_colour(scan_file: ScanFile) -> None:
    start = pcd_header(2, "x y z rgb", "4 4 4 4", "F F F F", "ascii")
    cloud = read_scan(scan_file("scan.pcd", start + b"0 0 0 4210752\n1 1 1 16711935\n"))
    np.testing.assert_array_equal(cloud.colors, [[64, 64, 64], [255, 0, 255]])


def test_a_colour_that_text_lost_is_dropped_not_black(scan_file: ScanFile) -> None:
    start = pcd_header(3, "x y z rgb", "4 4 4 4", "F F F F", "ascii")
    cloud = read_scan(scan_file("scan.pcd", start + b"0 0 0 4210752\n1 1 1 nan\n2 2 2 4210752\n"))
    assert len(cloud) == 2
    assert [note.code for note in cloud.diagnostics] == ["non_finite_points"]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_cut_file_is_damaged(cloud: PointCloud, scan_file: ScanFile, encoding: str) -> None:
    start = pcd_header(len(cloud), "x y z rgb", "4 4 4 4", "F F F U", encoding)
    body = pcd_body([*axes(cloud), packed_colors(cloud)], encoding)
    for kept in (0, 6, len(body) // 2, len(body) - 40):
        with pytest.raises(ScanDamagedError, match="truncated"):
            read_scan(scan_file("scan.pcd", start + body[:kept]))


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
def test_a_header_that_contradicts_itself_is_damaged(
    cloud: PointCloud, scan_file: ScanFile, old: str, new: str, said: str
) -> None:
    start = pcd_header(len(cloud), "x y z rgb", "4 4 4 4", "F F F U", "binary").decode().replace(old, new)
    with pytest.raises(ScanDamagedError, match=said):
        read_scan(scan_file("scan.pcd", start.encode() + bytes(60 * 24)))


def test_no_colour_or_no_coordinates_is_said(scan_file: ScanFile) -> None:
    with pytest.raises(ScanContentError, match="no colour"):
        read_scan(scan_file("scan.pcd", pcd_header(2, "x y z i", "4 4 4 4", "F F F F", "binary") + bytes(32)))
    with pytest.raises(ScanContentError, match="no x, y and z"):
        read_scan(scan_file("scan.pcd", pcd_header(2, "x y rgb i", "4 4 4 4", "F F F F", "binary") + bytes(32)))


def test_a_decompression_bomb_is_refused(scan_file: ScanFile) -> None:
    num_points = 100_000_000
    start = pcd_header(num_points, "x y z rgb", "4 4 4 4", "F F F U", "binary_compressed")
    with pytest.raises(ScanDamagedError, match="announces 1,600,000,000 in 1,000 bytes"):
        read_scan(scan_file("scan.pcd", start + struct.pack("<II", 1000, num_points * 16) + bytes(1000)))


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
