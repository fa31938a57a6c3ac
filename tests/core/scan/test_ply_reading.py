"""PLY files as programs write them, built byte by byte here: points, and Gaussian splats."""

import struct
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.ply.writer import encode_ply, write_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.scan.scan_files import CLOUD, NUM_POINTS, assert_same_points, read, splat_ply, table_of

BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
XYZ = "property float x\nproperty float y\nproperty float z\n"
RGB = "property uchar red\nproperty uchar green\nproperty uchar blue\n"


def header(encoding: str, *elements: str, newline: str = "\n") -> bytes:
    text = f"ply\nformat {encoding} 1.0\ncomment made by hand\n" + "".join(elements) + "end_header\n"
    return text.replace("\n", newline).encode()


def vertex_rows(position_type: str, color_type: str, scale: float = 1.0) -> bytes:
    rows = np.empty(NUM_POINTS, [("p", position_type, 3), ("c", color_type, 3)])
    rows["p"], rows["c"] = CLOUD.positions, CLOUD.colors.astype(float) * scale
    return rows.tobytes()


@pytest.mark.parametrize("encoding", BYTE_ORDERS)
@pytest.mark.parametrize("coordinate", ["float", "double"])
@pytest.mark.parametrize(("color", "scale"), [("uchar", 1), ("ushort", 257), ("float", 1 / 255), ("float", 1.0)])
def test_every_binary_layout_gives_the_same_points(encoding: str, coordinate: str, color: str, scale: float) -> None:
    codes = {"float": "f4", "double": "f8", "uchar": "u1", "ushort": "u2"}
    order = BYTE_ORDERS[encoding]
    properties = "".join(f"property {coordinate} {axis}\n" for axis in "xyz")
    properties += "".join(f"property {color} {name}\n" for name in ("red", "green", "blue"))
    data = vertex_rows(order + codes[coordinate], order + codes[color], scale)
    assert_same_points(read("scan.ply", header(encoding, f"element vertex {NUM_POINTS}\n", properties) + data))


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(("color", "scale"), [("uchar", None), ("float", 1 / 255)])
def test_ascii_is_read_with_every_line_end(newline: str, color: str, scale: float | None) -> None:
    properties = XYZ + RGB.replace("uchar", color)
    body = table_of(CLOUD, scale=scale).replace("\n", newline)
    start = header("ascii", f"element vertex {NUM_POINTS}\n", properties, newline=newline)
    assert_same_points(read("scan.ply", start + body.encode()))


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_a_binary_byte_that_looks_like_a_line_end_is_data(newline: str) -> None:
    data = bytearray(vertex_rows("<f4", "u1"))
    data[0] = 10
    start = header("binary_little_endian", f"element vertex {NUM_POINTS}\n", XYZ + RGB, newline=newline)
    expected = np.frombuffer(bytes(data[:4]), "<f4")[0]
    assert read("scan.ply", start + bytes(data)).positions[0, 0] == expected


@pytest.mark.parametrize(
    "names", [("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("Red", "Green", "Blue")]
)
def test_other_colour_names_are_known(names: tuple[str, str, str]) -> None:
    colors = "".join(f"property uchar {name}\n" for name in names)
    start = header("binary_little_endian", f"element vertex {NUM_POINTS}\n", XYZ + colors)
    assert_same_points(read("scan.ply", start + vertex_rows("<f4", "u1")))


def test_extra_properties_and_alpha_are_passed_over() -> None:
    layout = [("n", "<f4", 3), ("p", "<f8", 3), ("c", "u1", 4), ("s", "<i2")]
    rows = np.zeros(NUM_POINTS, layout)
    rows["p"], rows["c"][:, :3] = CLOUD.positions, CLOUD.colors
    properties = "".join(f"property float n{axis}\n" for axis in "xyz")
    properties += "".join(f"property double {axis}\n" for axis in "xyz") + RGB
    properties += "property uchar alpha\nproperty short station\n"
    start = header("binary_little_endian", f"element vertex {NUM_POINTS}\n", properties)
    assert_same_points(read("scan.ply", start + rows.tobytes()))


@pytest.mark.parametrize("encoding", ["ascii", *BYTE_ORDERS])
def test_elements_before_the_vertices_and_lists_in_them_are_walked_over(encoding: str) -> None:
    lengths = [number % 4 for number in range(NUM_POINTS)]
    elements = "element station 2\nproperty double height\nelement strip 2\nproperty list uchar short v\n"
    elements += f"element vertex {NUM_POINTS}\nproperty list ushort float echo\n{XYZ}{RGB}"
    if encoding == "ascii":
        rows = table_of(CLOUD).splitlines()
        echoes = [" ".join([str(length)] + ["0.5"] * length) for length in lengths]
        body = "1.5\n2.5\n3 1 2 3\n0\n" + "\n".join(map(" ".join, zip(echoes, rows, strict=True))) + "\n"
        data = body.encode()
    else:
        order = BYTE_ORDERS[encoding]
        data = struct.pack(order + "2d", 1.5, 2.5) + struct.pack(order + "B3hB", 3, 1, 2, 3, 0)
        for length, position, color in zip(lengths, CLOUD.positions, CLOUD.colors, strict=True):
            data += struct.pack(f"{order}H{length}f3f3B", length, *[0.5] * length, *position, *color)
    assert_same_points(read("scan.ply", header(encoding, elements) + data))


def test_what_write_ply_writes_is_read_back_exactly(tmp_path: Path) -> None:
    write_ply(tmp_path / "scan.ply", CLOUD)
    assert_same_points(read_scan(tmp_path / "scan.ply"), CLOUD, atol_m=0)
    far = PointCloud(CLOUD.positions, CLOUD.colors, np.array([690_000.0, 5_330_000.0, 500.0]))
    write_ply(tmp_path / "far.ply", far)
    assert_same_points(read_scan(tmp_path / "far.ply"), far, atol_m=1e-6)


def with_line(number: int, line: str) -> bytes:
    """Return the table of CLOUD with another line."""
    rows = table_of().splitlines(keepends=True)
    rows[number] = line + "\n"
    return "".join(rows).encode()


LITTLE, SIXTY = "binary_little_endian", f"element vertex {NUM_POINTS}\n"
ASCII = header("ascii", SIXTY, XYZ + RGB)
STRIP = "element strip 1\nproperty list int int v\nelement vertex 2\n"
MANY = "".join(f"property float p{number}\n" for number in range(2000))
WITHOUT_POINTS = {
    "no rows": (header("ascii", "element vertex 0\n", XYZ + RGB), "no points"),
    "no vertices": (header("ascii"), "no 'vertex' element"),
    "a texture that stayed at home": (
        header("ascii", "comment TextureFile room.png\n", "element vertex 1\n", XYZ) + b"1 2 3\n",
        "no colour.*upload both in one zip",
    ),
    "packed splats": (
        header(LITTLE, "element vertex 2\nproperty uint packed_position\n") + bytes(8),
        r"packed form\. Export them unpacked",
    ),
    "splats of haze": (splat_ply(CLOUD, np.full(NUM_POINTS, 0.1)), r"None of the 60 .* has an opacity of 0\.5 or more"),
    "a huge count": (header(LITTLE, "element vertex 9000000000\n", XYZ + RGB), "at most 200,000,000 points, got 9,000"),
}
DAMAGED = {
    "an impossible count": (header(LITTLE, "element vertex 150000000\n", XYZ + RGB), "expected 150,000,000 points"),
    "a cut binary file": (encode_ply(CLOUD)[: -10 * 15 - 8], "expected 60 points of .*for 49: the file is cut off"),
    "a cut ascii file": (
        ASCII + b"".join(with_line(7, "1 2 3 4 5 6").splitlines(True)[:40]),
        "60 rows .* ends after 40",
    ),
    "a line of five values": (ASCII + with_line(7, "1 2 3 4 5"), "Line 19 .*has 5 values, expected 6"),
    "a word in a line": (ASCII + with_line(7, "1 2 3 4 5 x6"), "Line 19 .*not a number"),
    "a colour beyond its type": (ASCII + with_line(3, "1 2 3 4 5 256"), "whole numbers of 8 bits"),
    "an endless list": (
        header(LITTLE, STRIP, XYZ + RGB) + struct.pack("<i", 2_000_000_000) + bytes(30),
        "ends after 0",
    ),
    "a negative list": (header(LITTLE, STRIP, XYZ + RGB) + struct.pack("<i", -1) + bytes(30), "ends after 0"),
    "no header": (b"ply\n", "PLY header is damaged"),
    "no format": (b"ply\nend_header\n", "PLY header is damaged"),
    "no end": (b"ply\nformat ascii 1.0\n" + b"comment x\n" * 200_000, "PLY header is damaged"),
    "a count below zero": (header(LITTLE, "element vertex -5\n"), "not a positive whole number"),
    "a count without end": (header(LITTLE, "element vertex 99999999999999999999\n"), "not a positive whole number"),
    "a property twice": (header(LITTLE, "element vertex 2\nproperty float x\n", XYZ + RGB), "'x' is declared twice"),
    "an element twice": (header(LITTLE, "element vertex 2\nelement vertex 3\n"), "declared twice"),
    "an unknown type": (header(LITTLE, "element vertex 2\nproperty quad x\n"), "unknown form or type"),
    "half a list": (header(LITTLE, "element vertex 2\nproperty list float int x\n"), "whole number type"),
    "a property of nothing": (header(LITTLE, "property float x\n"), "not understood"),
    "a line of its own": (header(LITTLE, "element vertex 2\nhello world\n"), "not understood"),
    "too many properties": (header(LITTLE, "element vertex 2\n" + MANY), "more than 1024"),
}


@pytest.mark.parametrize(("data", "said"), WITHOUT_POINTS.values(), ids=WITHOUT_POINTS)
def test_a_file_without_coloured_points_is_refused_with_the_reason(data: bytes, said: str) -> None:
    with pytest.raises(ScanContentError, match=said):
        read("scan.ply", data)


@pytest.mark.parametrize(("data", "said"), DAMAGED.values(), ids=DAMAGED)
def test_a_file_that_contradicts_itself_is_damaged(data: bytes, said: str) -> None:
    with pytest.raises(ScanDamagedError, match=said):
        read("scan.ply", data)


def test_centres_of_opaque_splats_are_points_with_the_colour_of_the_constant_harmonic() -> None:
    opacities = np.where(np.arange(NUM_POINTS) % 3, 0.98, 0.2)
    found, kept = read("splats.ply", splat_ply(CLOUD, opacities)), opacities > 0.5
    np.testing.assert_array_equal(found.positions, CLOUD.positions[kept])
    np.testing.assert_array_equal(found.colors, CLOUD.colors[kept])
    note = next(note for note in found.diagnostics if note.code == "splats_read")
    assert f"{kept.sum()} of {NUM_POINTS}" in note.message


def test_label_colours_in_text_keep_their_codes() -> None:
    start = header("ascii", "element vertex 2\n", XYZ + RGB)
    cloud = read("scan.ply", start + b"0 0 0 1 1 0\n1 1 1 0 1 1\n", color_kind="labels")
    np.testing.assert_array_equal(cloud.colors, [[1, 1, 0], [0, 1, 1]])


def test_bytes_beyond_what_the_header_announces_are_told() -> None:
    data = encode_ply(CLOUD)
    whole, longer = (read("scan.ply", each).diagnostics for each in (data, data + bytes(9)))
    assert "surplus_bytes" not in {each.code for each in whole}
    found = {each.code: each for each in longer}
    assert "9 bytes more" in found["surplus_bytes"].message
