"""PTX: several stations in one file, each with its pose, and cells without a return."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanFormatError, ScanTooLargeError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.painted_box import rotation_of
from tests.core.scan.ptx_files import station_text

ScanFile = Callable[[str, bytes | str], Path]
Compare = Callable[..., None]
POSES = ((rotation_of(70.0, 3.0, -2.0), np.array([1.0, -2.0, 1.6])), (rotation_of(-140.0), np.array([3.5, 0.5, 1.4])))


def two_stations(cloud: PointCloud, colored: tuple[bool, bool] = (True, True)) -> str:
    halves = np.split(cloud.positions.astype(np.float64), 2), np.split(cloud.colors, 2)
    return "".join(
        station_text(points, colors if has_color else None, *pose)
        for points, colors, pose, has_color in zip(*halves, POSES, colored, strict=True)
    )


def codes_of(cloud: PointCloud) -> list[str]:
    return [note.code for note in cloud.diagnostics]


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_stations_are_moved_by_their_poses(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, line_end: str
) -> None:
    read = read_scan(scan_file("scan.ptx", two_stations(cloud).replace("\n", line_end)))
    assert_same_points(read, cloud, 1e-6)
    assert codes_of(read) == ["scans_merged"]


def test_cells_without_a_return_are_no_points(cloud: PointCloud, scan_file: ScanFile) -> None:
    points = cloud.positions.astype(np.float64)
    points[::3] = np.nan
    read = read_scan(scan_file("scan.ptx", station_text(points, cloud.colors, *POSES[0], num_rows=4)))
    kept = np.arange(len(points)) % 3 != 0
    np.testing.assert_allclose(read.positions, cloud.positions[kept], atol=1e-6)
    np.testing.assert_array_equal(read.colors, cloud.colors[kept])
    assert read.num_points_read == kept.sum()


@pytest.mark.parametrize("value", ["inf", "1e308"])
def test_a_point_that_is_nowhere_is_left_out_and_said(cloud: PointCloud, scan_file: ScanFile, value: str) -> None:
    lines = two_stations(cloud).splitlines()
    _, *rest = lines[12].split()
    lines[12] = " ".join([value, *rest])
    read = read_scan(scan_file("scan.ptx", "\n".join(lines)))
    assert len(read.positions) == len(cloud.positions) - 1
    assert len(read.diagnostics) == 2


def test_the_content_tells_ptx_from_other_text(cloud: PointCloud, scan_file: ScanFile) -> None:
    assert len(read_scan(scan_file("scan", two_stations(cloud)))) == len(cloud)
    assert codes_of(read_scan(scan_file("scan.xyz", two_stations(cloud))))[0] == "extension_mismatch"
    with pytest.raises(ScanFormatError, match=r"named \.ptx.*plain text"):
        read_scan(scan_file("scan.ptx", "60\n1 2 3 0 4 5 6\n"))


def test_a_station_without_colour_is_left_out_and_said(cloud: PointCloud, scan_file: ScanFile) -> None:
    read = read_scan(scan_file("scan.ptx", two_stations(cloud, (False, True))))
    assert len(read) == len(cloud) / 2
    assert codes_of(read) == ["scans_without_color"]
    with pytest.raises(ScanContentError, match="no colour"):
        read_scan(scan_file("scan.ptx", two_stations(cloud, (False, False))))


def test_a_file_cut_short_is_damaged_wherever_it_ends(cloud: PointCloud, scan_file: ScanFile) -> None:
    lines = two_stations(cloud).splitlines(keepends=True)
    for num_lines, said in ((30, "announces 30 points, but the file ends after 20"), (44, "header of a station")):
        with pytest.raises(ScanDamagedError, match=said):
            read_scan(scan_file("scan.ptx", "".join(lines[:num_lines])))
    del lines[15]
    with pytest.raises(ScanDamagedError, match="Line 40 has 1 values, expected 7"):
        read_scan(scan_file("scan.ptx", "".join(lines)))


def test_absurd_counts_are_refused_before_anything_is_read(cloud: PointCloud, scan_file: ScanFile) -> None:
    text = two_stations(cloud).replace("30\n1\n", "4000000\n4000000\n", 1)
    with pytest.raises(ScanTooLargeError, match="at most 200,000,000 points"):
        read_scan(scan_file("scan.ptx", text))
    with pytest.raises(ScanTooLargeError, match="at most 40 points, got 60"):
        read_scan(scan_file("scan.ptx", two_stations(cloud)), ScanOptions(max_points=40))


@pytest.mark.parametrize("matrix_line", ["0 0 0 0", "nan 0 0 0", "1 0 0 7"])
def test_a_matrix_that_is_no_pose_is_refused(cloud: PointCloud, scan_file: ScanFile, matrix_line: str) -> None:
    lines = two_stations(cloud).splitlines()
    lines[6] = matrix_line
    with pytest.raises(ScanDamagedError, match="not a pose"):
        read_scan(scan_file("scan.ptx", "\n".join(lines)))


@pytest.mark.parametrize("row", ["1 2 3 0.5 1 2", "1 2"])
def test_a_point_with_other_columns_is_named_with_its_line(cloud: PointCloud, scan_file: ScanFile, row: str) -> None:
    lines = two_stations(cloud).splitlines()
    lines[10] = row
    with pytest.raises(ScanDamagedError, match="Line 11 has"):
        read_scan(scan_file("scan.ptx", "\n".join(lines)))
