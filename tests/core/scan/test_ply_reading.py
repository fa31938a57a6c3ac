"""PLY files as programs write them, built byte by byte here."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.ply.writer import encode_ply, write_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan

ScanFile = Callable[[str, bytes | str], Path]
Compare = Callable[..., None]
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
XYZ = "property float x\nproperty float y\nproperty float z\n"
RGB = "property uchar red\nproperty uchar green\nproperty uchar blue\n"


def header(encoding: str, *elements: str, newline: str = "\n") -> bytes:
    text = f"ply\nformat {encoding} 1.0\ncomment made by hand\n" + "".join(elements) + "end_header\n"
    return text.replace("\n", newline).encode()


def vertex_rows(cloud: PointCloud, position_type: str, color_type: str, scale: float = 1.0) -> bytes:
    rows = np.empty(len(cloud), [("p", position_type, 3), ("c", color_type, 3)])
    rows["p"], rows["c"] = cloud.positions, cloud.colors.astype(float) * scale
    return rows.tobytes()


def ascii_rows(cloud: PointCloud, scale: float | None = None) -> str:
    colors = cloud.colors if scale is None else cloud.colors * scale
    lines = [
        " ".join(f"{value:.3f}" for value in position) + " " + " ".join(str(value) for value in color)
        for position, color in zip(cloud.positions.tolist(), colors.tolist(), strict=True)
    ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("encoding", BYTE_ORDERS)
@pytest.mark.parametrize("coordinate", ["float", "double"])
@pytest.mark.parametrize(("color", "scale"), [("uchar", 1), ("ushort", 257), ("float", 1 / 255), ("float", 1.0)])
def test_every_binary_layout_gives_the_same_points(
    cloud: PointCloud,
    scan_file: ScanFile,
    assert_same_points: Compare,
    encoding: str,
    coordinate: str,
    color: str,
    scale: float,
) -> None:
    codes = {"float": "f4", "double": "f8", "uchar": "u1", "ushort": "u2"}
    order = BYTE_ORDERS[encoding]
    properties = "".join(f"property {coordinate} {axis}\n" for axis in "xyz")
    properties += "".join(f"property {color} {name}\n" for name in ("red", "green", "blue"))
    data = vertex_rows(cloud, order + codes[coordinate], order + codes[color], scale)
    path = scan_file("scan.ply", header(encoding, f"element vertex {len(cloud)}\n", properties) + data)
    assert_same_points(read_scan(path), cloud)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(("color", "scale"), [("uchar", None), ("float", 1 / 255)])
def test_ascii_is_read_with_every_line_end(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, newline: str, color: str, scale: float | None
) -> None:
    properties = XYZ + RGB.replace("uchar", color)
    body = ascii_rows(cloud, scale).replace("\n", newline)
    start = header("ascii", f"element vertex {len(cloud)}\n", properties, newline=newline)
    assert_same_points(read_scan(scan_file("scan.ply", start + body.encode())), cloud)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_a_binary_byte_that_looks_like_a_line_end_is_data(cloud: PointCloud, scan_file: ScanFile, newline: str) -> None:
    data = bytearray(vertex_rows(cloud, "<f4", "u1"))
    data[0] = 10
    start = header("binary_little_endian", f"element vertex {len(cloud)}\n", XYZ + RGB, newline=newline)
    expected = np.frombuffer(bytes(data[:4]), "<f4")[0]
    assert read_scan(scan_file("scan.ply", start + bytes(data))).positions[0, 0] == expected


@pytest.mark.parametrize(
    "names", [("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("Red", "Green", "Blue")]
)
def test_other_colour_names_are_known(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, names: tuple[str, str, str]
) -> None:
    colors = "".join(f"property uchar {name}\n" for name in names)
    start = header("binary_little_endian", f"element vertex {len(cloud)}\n", XYZ + colors)
    path = scan_file("scan.ply", start + vertex_rows(cloud, "<f4", "u1"))
    assert_same_points(read_scan(path), cloud)


def test_extra_properties_and_alpha_are_passed_over(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare
) -> None:
    layout = [("n", "<f4", 3), ("p", "<f8", 3), ("c", "u1", 4), ("s", "<i2")]
    rows = np.zeros(len(cloud), layout)
    rows["p"], rows["c"][:, :3] = cloud.positions, cloud.colors
    properties = "".join(f"property float n{axis}\n" for axis in "xyz")
    properties += "".join(f"property double {axis}\n" for axis in "xyz") + RGB
    properties += "property uchar alpha\nproperty short station\n"
    start = header("binary_little_endian", f"element vertex {len(cloud)}\n", properties)
    assert_same_points(read_scan(scan_file("scan.ply", start + rows.tobytes())), cloud)


@pytest.mark.parametrize("encoding", ["ascii", *BYTE_ORDERS])
def test_elements_before_the_vertices_and_lists_in_them_are_walked_over(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, encoding: str
) -> None:
    lengths = [number % 4 for number in range(len(cloud))]
    elements = "element station 2\nproperty double height\nelement strip 2\nproperty list uchar short v\n"
    elements += f"element vertex {len(cloud)}\nproperty list ushort float echo\n{XYZ}{RGB}"
    if encoding == "ascii":
        rows = ascii_rows(cloud).splitlines()
        echoes = [" ".join([str(length)] + ["0.5"] * length) for length in lengths]
        body = "1.5\n2.5\n3 1 2 3\n0\n" + "\n".join(map(" ".join, zip(echoes, rows, strict=True))) + "\n"
        data = body.encode()
    else:
        order = BYTE_ORDERS[encoding]
        data = struct.pack(order + "2d", 1.5, 2.5) + struct.pack(order + "B3hB", 3, 1, 2, 3, 0)
        for length, position, color in zip(lengths, cloud.positions, cloud.colors, strict=True):
            data += struct.pack(f"{order}H{length}f3f3B", length, *[0.5] * length, *position, *color)
    path = scan_file("scan.ply", header(encoding, elements) + data)
    assert_same_points(read_scan(path), cloud)


def test_what_write_ply_writes_is_read_back_exactly(
    cloud: PointCloud, tmp_path: Path, assert_same_points: Compare
) -> None:
    write_ply(tmp_path / "scan.ply", cloud)
    assert_same_points(read_scan(tmp_path / "scan.ply"), cloud, atol_m=0)
    far = PointCloud(cloud.positions, cloud.colors, np.array([690_000.0, 5_330_000.0, 500.0]))
    write_ply(tmp_path / "far.ply", far)
    assert_same_points(read_scan(tmp_path / "far.ply"), far, atol_m=1e-6)


def test_a_vertex_element_without_rows_holds_no_points(scan_file: ScanFile) -> None:
    with pytest.raises(ScanContentError, match="no points"):
        read_scan(scan_file("scan.ply", header("ascii", "element vertex 0\n", XYZ + RGB)))
    with pytest.raises(ScanContentError, match="no 'vertex' element"):
        read_scan(scan_file("scan.ply", header("ascii")))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("element vertex -5\n" + XYZ + RGB, "not a positive whole number"),
        ("element vertex 99999999999999999999\n" + XYZ + RGB, "not a positive whole number"),
        ("element vertex 2\nproperty float x\n" + XYZ + RGB, "'x' is declared twice"),
        ("element vertex 2\nelement vertex 3\n", "declared twice"),
        ("element vertex 2\nproperty quad x\n", "unknown form or type"),
        ("element vertex 2\nproperty list float int x\n", "whole number type"),
        ("property float x\n", "not understood"),
        ("element vertex 2\nhello world\n", "not understood"),
        ("element vertex 2\n" + "".join(f"property float p{number}\n" for number in range(2000)), "more than 1024"),
    ],
)
def test_a_header_that_contradicts_itself_is_damaged(scan_file: ScanFile, lines: str, said: str) -> None:
    with pytest.raises(ScanDamagedError, match=said):
        read_scan(scan_file("scan.ply", header("binary_little_endian", lines)))


@pytest.mark.parametrize("text", ["ply\n", "ply\nend_header\n", "ply\nformat ascii 1.0\n" + "comment x\n" * 200_000])
def test_a_header_without_format_or_end_is_damaged(scan_file: ScanFile, text: str) -> None:
    with pytest.raises(ScanDamagedError, match="PLY header is damaged"):
        read_scan(scan_file("scan.ply", text))


def test_a_cut_binary_file_names_both_counts(cloud: PointCloud, scan_file: ScanFile) -> None:
    data = encode_ply(cloud)
    with pytest.raises(
        ScanDamagedError, match=r"expected 60 points of .*enough for 49: the file is cut off.*upload it again"
    ):
        read_scan(scan_file("scan.ply", data[: -10 * 15 - 8]))


def test_a_cut_ascii_file_names_both_counts(cloud: PointCloud, scan_file: ScanFile) -> None:
    body = "".join(ascii_rows(cloud).splitlines(keepends=True)[:40])
    start = header("ascii", f"element vertex {len(cloud)}\n", XYZ + RGB)
    with pytest.raises(ScanDamagedError, match="announces 60 rows of 'vertex', but the file ends after 40"):
        read_scan(scan_file("scan.ply", start + body.encode()))


def test_an_ascii_line_that_does_not_fit_is_named(cloud: PointCloud, scan_file: ScanFile) -> None:
    start = header("ascii", f"element vertex {len(cloud)}\n", XYZ + RGB)
    for damage, said in (("1 2 3 4 5\n", "has 5 values, expected 6"), ("1 2 3 4 5 x6\n", "not a number")):
        rows = ascii_rows(cloud).splitlines(keepends=True)
        rows[7] = damage
        with pytest.raises(ScanDamagedError, match=rf"Line 19 .*{said}"):
            read_scan(scan_file("scan.ply", start + "".join(rows).encode()))


def test_ascii_colours_beyond_their_declared_type_are_damaged(cloud: PointCloud, scan_file: ScanFile) -> None:
    rows = ascii_rows(cloud).splitlines(keepends=True)
    rows[3] = "1 2 3 4 5 256\n"
    start = header("ascii", f"element vertex {len(cloud)}\n", XYZ + RGB)
    with pytest.raises(ScanDamagedError, match="whole numbers of 8 bits"):
        read_scan(scan_file("scan.ply", start + "".join(rows).encode()))


def test_a_huge_count_is_refused_before_anything_is_read(scan_file: ScanFile) -> None:
    with pytest.raises(ScanContentError, match=r"at most 200,000,000 points, got 9,000,000,000"):
        read_scan(scan_file("scan.ply", header("binary_little_endian", "element vertex 9000000000\n", XYZ + RGB)))
    with pytest.raises(ScanDamagedError, match=r"expected 150,000,000 points"):
        read_scan(scan_file("scan.ply", header("binary_little_endian", "element vertex 150000000\n", XYZ + RGB)))


def test_a_list_longer_than_the_file_is_damaged(scan_file: ScanFile) -> None:
    elements = "element strip 1\nproperty list int int v\nelement vertex 2\n" + XYZ + RGB
    for length in (2_000_000_000, -1):
        data = header("binary_little_endian", elements) + struct.pack("<i", length) + bytes(30)
        with pytest.raises(ScanDamagedError):
            read_scan(scan_file("scan.ply", data))


def test_a_textured_mesh_is_told_to_come_with_its_texture(scan_file: ScanFile) -> None:
    start = header("ascii", "comment TextureFile room.png\n", "element vertex 1\n", XYZ)
    with pytest.raises(ScanContentError, match=r"no colour.*upload both in one zip"):
        read_scan(scan_file("scan.ply", start + b"1 2 3\n"))


def test_label_colours_in_text_keep_their_codes(scan_file: ScanFile) -> None:
    start = header("ascii", "element vertex 2\n", XYZ + RGB)
    path = scan_file("scan.ply", start + b"0 0 0 1 1 0\n1 1 1 0 1 1\n")
    cloud = read_scan(path, ScanOptions(color_kind="labels"))
    np.testing.assert_array_equal(cloud.colors, [[1, 1, 0], [0, 1, 1]])


def test_bytes_beyond_what_the_header_announces_are_told(cloud: PointCloud, scan_file: ScanFile) -> None:
    data = encode_ply(cloud)
    whole, longer = (read_scan(scan_file("scan.ply", each)).diagnostics for each in (data, data + bytes(9)))
    assert "surplus_bytes" not in {each.code for each in whole}
    found = {each.code: each for each in longer}
    assert "9 bytes more" in found["surplus_bytes"].message
