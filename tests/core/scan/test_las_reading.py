"""LAS and LAZ files, written with laspy and then damaged by hand."""

import struct
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from panoloc.core.scan.reading_context import ReadingContext
from panoloc.core.scan.sandbox.limits import SandboxLimits
from panoloc.core.scan.sandbox.reading import read_in_sandbox

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


@pytest.mark.parametrize(
    ("name", "point_format", "color_scale"),
    [("a.las", 2, 1), ("a.las", 8, 256), ("a.laz", 3, 257), ("a.laz", 7, 257)],
)
def test_coloured_formats_and_colour_depths(
    cloud: PointCloud, tmp_path: Path, assert_same_points: Compare, name: str, point_format: int, color_scale: int
) -> None:
    assert_same_points(read_scan(write_las(tmp_path / name, cloud, point_format, color_scale)), cloud)


def test_survey_coordinates_keep_their_millimetres(
    cloud: PointCloud, tmp_path: Path, assert_same_points: Compare
) -> None:
    far = PointCloud(cloud.positions, cloud.colors, np.array([691_000.0, 5_335_000.0, 520.0]))
    read = read_scan(write_las(tmp_path / "scan.las", far))
    assert_same_points(read, far, atol_m=1e-5)
    assert "large_coordinates" in [note.code for note in read.diagnostics]
    assert np.abs(read.positions).max() < 10


def test_files_without_colour_say_so(cloud: PointCloud, tmp_path: Path) -> None:
    with pytest.raises(ScanContentError, match=r"no colour.*point format 6"):
        read_scan(write_las(tmp_path / "scan.las", cloud, 6, color_scale=0))
    with pytest.raises(ScanContentError, match=r"\(0, 0, 0\)"):
        read_scan(write_las(tmp_path / "scan.laz", cloud, color_scale=0))


@pytest.mark.parametrize("name", ["scan.las", "scan.laz"])
def test_a_cut_file_is_damaged(cloud: PointCloud, tmp_path: Path, name: str) -> None:
    whole = write_las(tmp_path / name, cloud, 3).read_bytes()
    for kept in (10, 230, 500, -20):
        (tmp_path / name).write_bytes(whole[:kept])
        with pytest.raises(ScanDamagedError, match="truncated"):
            read_scan(tmp_path / name)


@pytest.mark.parametrize("name", ["scan.las", "scan.laz"])
def test_more_points_announced_than_there_are(cloud: PointCloud, tmp_path: Path, name: str) -> None:
    path = patched(write_las(tmp_path / name, cloud), 107, "<I", 100_000_000)
    with pytest.raises(ScanDamagedError, match=r"cannot be read after (0|60) of 100,000,000 points"):
        read_scan(path)
    with pytest.raises(ScanContentError, match="at most 200,000,000"):
        read_scan(patched(path, 107, "<I", 4_000_000_000))
    with pytest.raises(ScanContentError, match="no points"):
        read_scan(patched(path, 107, "<I", 0))


@pytest.mark.parametrize(
    ("offset", "layout", "value"),
    [
        (96, "<I", 50),  # where the points begin
        (96, "<I", 1 << 30),
        (100, "<I", 1 << 31),  # records
        (243, "<I", (1 << 32) - 1),  # extended records
        (235, "<Q", 1 << 60),
        (104, "<B", 63),  # point format
        (105, "<H", 12),  # bytes per point
    ],
)
def test_a_header_that_contradicts_itself_is_damaged_at_once(
    cloud: PointCloud, tmp_path: Path, offset: int, layout: str, value: int
) -> None:
    path = write_las(tmp_path / "scan.las", cloud, point_format=7)
    if offset == 235:
        patched(path, 243, "<I", 1)
    with pytest.raises(ScanDamagedError):
        read_scan(patched(path, offset, layout, value))


def test_the_sandbox_stops_a_laz_file_that_announces_allocations_beyond_every_memory(
    cloud: PointCloud, tmp_path: Path
) -> None:
    path = write_las(tmp_path / "scan.laz", cloud, point_format=3)
    good = path.read_bytes()
    start = struct.unpack_from("<I", good, 96)[0]
    table = struct.unpack_from("<q", good, start)[0]
    for offset, layout, value in [
        (start, "<q", 1 << 60),  # where the chunk table lies
        (start, "<q", 0),
        (table + 4, "<I", 0xFFFFFFF0),  # chunks: 64 GiB of table
    ]:
        path.write_bytes(good)
        with pytest.raises(ScanDamagedError, match="cannot be read"):
            read_scan(patched(path, offset, layout, value))


def test_the_sandbox_stops_a_layer_of_a_laz_chunk_that_is_larger_than_its_memory(
    cloud: PointCloud, tmp_path: Path
) -> None:
    path = write_las(tmp_path / "scan.laz", cloud, point_format=7)
    (start,), (record_bytes,) = (struct.unpack_from(at, path.read_bytes(), n) for at, n in (("<I", 96), ("<H", 105)))
    patched(path, start + 8 + record_bytes + 4, "<I", 0xFFFFFFF0)
    context = ReadingContext(path, ScanOptions(), path.stat().st_size)
    with pytest.raises(ScanError, match=r"cannot be read|more than 1 GiB"):
        list(read_in_sandbox("las", context, SandboxLimits(memory_bytes=1 << 30)))


def test_damage_inside_compressed_points_never_crashes(cloud: PointCloud, tmp_path: Path) -> None:
    path = write_las(tmp_path / "scan.laz", cloud, point_format=3)
    good, start = path.read_bytes(), struct.unpack_from("<I", path.read_bytes(), 96)[0] + 8
    outcomes = []
    for offset in range(start, start + 200, 50):
        path.write_bytes(good[:offset] + bytes(20) + good[offset + 20 :])
        try:
            outcomes.append(str(len(read_scan(path))))
        except ScanError as error:
            outcomes.append(str(error))
    assert len(outcomes) == 4
    assert all(outcomes)
