"""LAS and LAZ files, written with laspy and then damaged by hand."""

import struct
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.sandbox import SandboxLimits
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading_context import ReadingContext
from panoloc.core.scan.sandbox.reading import read_in_sandbox
from tests.core.scan.scan_files import CLOUD, assert_same_points, codes_of, las_of, put, read


def patched(data: bytes, offset: int, layout: str, value: int) -> bytes:
    changed = bytearray(data)
    struct.pack_into(layout, changed, offset, value)
    return bytes(changed)


@pytest.mark.parametrize(
    ("name", "point_format", "color_scale"),
    [("a.las", 2, 1), ("a.las", 8, 256), ("a.laz", 3, 257), ("a.laz", 7, 257)],
)
def test_coloured_formats_and_colour_depths(name: str, point_format: int, color_scale: int) -> None:
    assert_same_points(read(name, las_of(CLOUD, point_format, color_scale, compressed=name.endswith("z"))))


def test_survey_coordinates_keep_their_millimetres() -> None:
    far = PointCloud(CLOUD.positions, CLOUD.colors, np.array([691_000.0, 5_335_000.0, 520.0]))
    found = read("scan.las", las_of(far, compressed=False))
    assert_same_points(found, far, atol_m=1e-5)
    assert "large_coordinates" in codes_of(found)
    assert np.abs(found.positions).max() < 10


def test_files_without_colour_say_so() -> None:
    with pytest.raises(ScanContentError, match=r"no colour.*point format 6"):
        read("scan.las", las_of(CLOUD, 6, color_scale=0, compressed=False))
    with pytest.raises(ScanContentError, match=r"\(0, 0, 0\)"):
        read("scan.laz", las_of(CLOUD, color_scale=0))


@pytest.mark.parametrize("compressed", [True, False])
def test_a_cut_file_is_damaged(compressed: bool) -> None:
    whole = las_of(CLOUD, 3, compressed=compressed)
    for kept in (10, 230, 500, -20):
        with pytest.raises(ScanDamagedError, match="truncated"):
            read("scan.las", whole[:kept])


@pytest.mark.parametrize("compressed", [True, False])
def test_more_points_announced_than_there_are(compressed: bool) -> None:
    data = las_of(compressed=compressed)
    for count, error, said in (
        (100_000_000, ScanDamagedError, r"cannot be read after (0|60) of 100,000,000 points"),
        (4_000_000_000, ScanContentError, "at most 200,000,000"),
        (0, ScanContentError, "no points"),
    ):
        with pytest.raises(error, match=said):
            read("scan.las", patched(data, 107, "<I", count))


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
def test_a_header_that_contradicts_itself_is_damaged_at_once(offset: int, layout: str, value: int) -> None:
    data = las_of(CLOUD, 7, compressed=False)
    if offset == 235:
        data = patched(data, 243, "<I", 1)
    with pytest.raises(ScanDamagedError):
        read("scan.las", patched(data, offset, layout, value))


def test_the_sandbox_stops_a_laz_file_that_announces_allocations_beyond_every_memory() -> None:
    data = las_of(CLOUD, 3)
    (start,) = struct.unpack_from("<I", data, 96)
    (table,) = struct.unpack_from("<q", data, start)
    for offset, layout, value in [
        (start, "<q", 1 << 60),  # where the chunk table lies
        (start, "<q", 0),
        (table + 4, "<I", 0xFFFFFFF0),  # chunks: 64 GiB of table
    ]:
        with pytest.raises(ScanDamagedError, match="cannot be read"):
            read("scan.laz", patched(data, offset, layout, value))


def test_the_sandbox_stops_a_layer_of_a_laz_chunk_that_is_larger_than_its_memory(tmp_path: Path) -> None:
    data = las_of(CLOUD, 7)
    (start,), (record_bytes,) = struct.unpack_from("<I", data, 96), struct.unpack_from("<H", data, 105)
    path = put(tmp_path, "scan.laz", patched(data, start + 8 + record_bytes + 4, "<I", 0xFFFFFFF0))
    context = ReadingContext(path, ScanOptions(), path.stat().st_size)
    with pytest.raises(ScanError, match=r"cannot be read|more than 1 GiB"):
        list(read_in_sandbox("las", context, SandboxLimits(memory_bytes=1 << 30)))


def test_damage_inside_compressed_points_never_crashes() -> None:
    data = las_of(CLOUD, 3)
    start = struct.unpack_from("<I", data, 96)[0] + 8
    outcomes = []
    for offset in range(start, start + 200, 50):
        try:
            outcomes.append(str(len(read("scan.laz", data[:offset] + bytes(20) + data[offset + 20 :]))))
        except ScanError as error:
            outcomes.append(str(error))
    assert len(outcomes) == 4
    assert all(outcomes)
