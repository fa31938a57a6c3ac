"""What is said of a PLY file by its header alone, before anybody reads it."""

from pathlib import Path

import pytest

from panoloc.core.errors import ScanDamagedError, ScanTooLargeError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.ply.header import check_ply_file


def header_of(properties: str, count: int, more: str = "") -> bytes:
    lines = [
        "ply",
        "format binary_big_endian 1.0",
        "comment x",
        f"element vertex {count}",
        *properties.split(";"),
        more,
    ]
    return "\r\n".join([*filter(None, lines), "end_header"]).encode() + b"\r\n"


@pytest.mark.parametrize(
    ("properties", "stride"),
    [
        ("property float x;property float y;property float z", 12),
        ("property double x;property uchar red;property int8 a", 10),
    ],
)
def test_a_binary_ply_holds_all_its_vertices_or_is_cut_off(tmp_path: Path, properties: str, stride: int) -> None:
    file = tmp_path / "a.ply"
    header = header_of(properties, 10, "element face 3\r\nproperty list uchar int vertex_indices")
    file.write_bytes(header + bytes(10 * stride) + bytes(3))  # the lists of the faces are empty
    check_ply_file(file, ScanOptions(max_points=10))
    file.write_bytes(header + bytes(10 * stride - 1))
    with pytest.raises(ScanDamagedError, match=f"10 points of {stride} bytes"):
        check_ply_file(file, ScanOptions(max_points=10))


@pytest.mark.parametrize(
    "content",
    [
        b"ply\nformat ascii 1.0\nelement vertex 5\nend_header\n",
        header_of("property unknown x", 5),
        b"ply\nno end",
        b"LASF....",
    ],
)
def test_what_cannot_be_checked_cheaply_is_left_to_the_reader(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "a.ply"
    file.write_bytes(content)
    check_ply_file(file, ScanOptions(max_points=10))


def test_a_ply_that_ends_within_its_faces_is_cut_off_although_rows_differ_in_size(tmp_path: Path) -> None:
    file = tmp_path / "a.ply"
    file.write_bytes(header_of("property list uchar int x", 5) + bytes(4))
    with pytest.raises(ScanDamagedError, match=r"5 points of at least 1 bytes .* enough for 4: the file is cut off"):
        check_ply_file(file, ScanOptions())
    file.write_bytes(header_of("property list uchar int x", 5) + bytes(5))
    check_ply_file(file, ScanOptions())


def test_more_points_than_allowed_are_refused_by_the_header_alone(tmp_path: Path) -> None:
    file = tmp_path / "a.ply"
    file.write_bytes(header_of("property float x", 11))
    with pytest.raises(ScanTooLargeError, match="at most 10 points, got 11"):
        check_ply_file(file, ScanOptions(max_points=10))
