"""LAS and LAZ files, written with laspy and then damaged by hand."""

import struct
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pytest

from core.errors import ScanContentError, ScanDamagedError, ScanError
from core.scan.point_cloud import PointCloud
from core.scan.reading import read_scan

Compare = Callable[..., None]


def write_las(path: Path, cloud: PointCloud, point_format: int = 2, color_scale: int = 257) -> Path:
    version = "1.4" if point_format >= 6 else "1.2"
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales = np.full(3, 0.001)
    header.offsets = np.floor(cloud.origin_offset)
    las = laspy.LasData(header)
    las.x, las.y, las.z = (cloud.positions + cloud.origin_offset).T
    if color_scale:
        las.red, las.green, las.blue = cloud.colors.T.astype(np.uint16) * color_scale
    las.write(path)
    return path


def patched(path: Path, offset: int, layout: str, *values: int) -> Path:
    data = bytearray(path.read_bytes())
    struct.pack_into(layout, data, offset, *values)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("name", ["scan.las", "scan.laz"])
@pytest.mark.parametrize("point_format", [2, 3, 7, 8])
@pytest.mark.parametrize("color_scale", [1, 256, 257])
def test_coloured_formats_and_colour_depths(
    cloud: PointCloud, tmp_path: Path, assert_same_points: Compare, name: str, point_format: int, color_scale: int
) -> None:
    path = write_las(tmp_path / name, cloud, point_format, color_scale)
    assert_same_points(read_scan(path), cloud)


def test_survey_coordinates_keep_their_millimetres(
    cloud: PointCloud, tmp_path: Path, assert_same_points: Compare
) -> None:
    far = PointCloud(cloud.positions, cloud.colors, np.array([691_000.0, 5_335_000.0, 520.0]))
    read = read_scan(write_las(tmp_path / "scan.las", far))
    assert_same_points(read, far, atol_m=1e-5)
    assert "large_coordinates" in [note.code for note in read.diagnostics]
    assert np.abs(read.positions).max() < 10


@pytest.mark.parametrize("point_format", [0, 1, 6])
def test_formats_without_colour_are_said(cloud: PointCloud, tmp_path: Path, point_format: int) -> None:
    path = write_las(tmp_path / "scan.las", cloud, point_format, color_scale=0)
    with pytest.raises(ScanContentError, match=f"no colour.*point format {point_format}"):
        read_scan(path)


@pytest.mark.parametrize("name", ["scan.las", "scan.laz"])
def test_colour_fields_that_were_never_filled_are_said(cloud: PointCloud, tmp_path: Path, name: str) -> None:
    with pytest.raises(ScanContentError, match=r"\(0, 0, 0\)"):
        read_scan(write_las(tmp_path / name, cloud, color_scale=0))


@pytest.mark.parametrize("name", ["scan.las", "scan.laz"])
@pytest.mark.parametrize("kept", [10, 230, 500, -20])
def test_a_cut_file_is_damaged(cloud: PointCloud, tmp_path: Path, name: str, kept: int) -> None:
    path = write_las(tmp_path / name, cloud, 3)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(ScanDamagedError, match="cut short"):
        read_scan(path)


@pytest.mark.parametrize("name", ["scan.las", "scan.laz"])
def test_more_points_announced_than_there_are(cloud: PointCloud, tmp_path: Path, name: str) -> None:
    path = patched(write_las(tmp_path / name, cloud), 107, "<I", 100_000_000)
    known = "enough for 60" if name.endswith("las") else "there are 1 chunks; expected 2,000"
    with pytest.raises(ScanDamagedError, match=f"announces 100,000,000 points.*{known}"):
        read_scan(path)
    with pytest.raises(ScanContentError, match="at most 200,000,000"):
        read_scan(patched(path, 107, "<I", 4_000_000_000))
    with pytest.raises(ScanContentError, match="no points"):
        read_scan(patched(path, 107, "<I", 0))


@pytest.mark.parametrize(
    ("offset", "layout", "value", "said"),
    [
        (24, "<B", 7, "version 7"),
        (96, "<I", 50, "contradicts itself"),
        (96, "<I", 1 << 30, "places its points"),
        (100, "<I", 1 << 31, "contradicts itself"),
        (104, "<B", 63, "point format 63"),
        (105, "<H", 12, "with 12 bytes per point"),
    ],
)
def test_a_header_that_contradicts_itself_is_damaged(
    cloud: PointCloud, tmp_path: Path, offset: int, layout: str, value: int, said: str
) -> None:
    with pytest.raises(ScanDamagedError, match=said):
        read_scan(patched(write_las(tmp_path / "scan.las", cloud), offset, layout, value))


def point_data_offset(path: Path) -> int:
    return int(struct.unpack_from("<I", path.read_bytes(), 96)[0])


def test_sizes_in_a_laz_file_are_checked_before_they_are_allocated(cloud: PointCloud, tmp_path: Path) -> None:
    path = write_las(tmp_path / "scan.laz", cloud, point_format=7)
    start = point_data_offset(path)
    table = struct.unpack_from("<q", path.read_bytes(), start)[0]
    (record_bytes,) = struct.unpack_from("<H", path.read_bytes(), 105)
    good = path.read_bytes()
    for offset, layout, value, said in [
        (start, "<q", 1 << 60, "chunk table should lie at byte"),
        (start, "<q", 0, "chunk table should lie at byte"),
        (table + 4, "<I", 0xFFFFFFF0, "4,294,967,280 chunks; expected 1"),
        (start + 8 + record_bytes + 4, "<I", 0xFFFFFFF0, "chunk 0 announces more than its"),
    ]:
        path.write_bytes(good)
        with pytest.raises(ScanDamagedError, match=said):
            read_scan(patched(path, offset, layout, value))


def test_damage_inside_compressed_points_never_crashes(cloud: PointCloud, tmp_path: Path) -> None:
    path = write_las(tmp_path / "scan.laz", cloud, point_format=3)
    good, start = path.read_bytes(), point_data_offset(path) + 8
    num_read, errors = 0, []
    for offset in range(start, start + 200, 10):
        path.write_bytes(good[:offset] + bytes(20) + good[offset + 20 :])
        try:
            num_read += len(read_scan(path)) > 0
        except ScanError as error:
            errors.append(str(error))
    assert num_read + len(errors) == 20
    assert all(errors)
