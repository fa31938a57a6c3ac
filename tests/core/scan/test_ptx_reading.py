"""PTX: several stations in one file, each with its pose, and cells without a return."""

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanFormatError, ScanTooLargeError
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.painted_box import rotation_of
from tests.core.scan.scan_files import CLOUD, assert_same_points, codes_of, read, station_text

POSES = ((rotation_of(70.0, 3.0, -2.0), np.array([1.0, -2.0, 1.6])), (rotation_of(-140.0), np.array([3.5, 0.5, 1.4])))


def two_stations(cloud: PointCloud, colored: tuple[bool, bool] = (True, True)) -> str:
    halves = np.split(cloud.positions.astype(np.float64), 2), np.split(cloud.colors, 2)
    return "".join(
        station_text(points, colors if has_color else None, *pose)
        for points, colors, pose, has_color in zip(*halves, POSES, colored, strict=True)
    )


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_stations_are_moved_by_their_poses(line_end: str) -> None:
    found = read("scan.ptx", two_stations(CLOUD).replace("\n", line_end))
    assert_same_points(found, CLOUD, 1e-6)
    assert codes_of(found) == ["scans_merged"]


def test_cells_without_a_return_are_no_points() -> None:
    points = CLOUD.positions.astype(np.float64)
    points[::3] = np.nan
    found = read("scan.ptx", station_text(points, CLOUD.colors, *POSES[0], num_rows=4))
    kept = np.arange(len(points)) % 3 != 0
    np.testing.assert_allclose(found.positions, CLOUD.positions[kept], atol=1e-6)
    np.testing.assert_array_equal(found.colors, CLOUD.colors[kept])
    assert found.num_points_read == kept.sum()


@pytest.mark.parametrize("value", ["inf", "1e308"])
def test_a_point_that_is_nowhere_is_left_out_and_said(value: str) -> None:
    lines = two_stations(CLOUD).splitlines()
    _, *rest = lines[12].split()
    lines[12] = " ".join([value, *rest])
    found = read("scan.ptx", "\n".join(lines))
    assert len(found.positions) == len(CLOUD.positions) - 1
    assert len(found.diagnostics) == 2


def test_the_content_tells_ptx_from_other_text() -> None:
    assert len(read("scan", two_stations(CLOUD))) == len(CLOUD)
    assert codes_of(read("scan.xyz", two_stations(CLOUD)))[0] == "extension_mismatch"
    with pytest.raises(ScanFormatError, match=r"named \.ptx.*plain text"):
        read("scan.ptx", "60\n1 2 3 0 4 5 6\n")


def test_a_station_without_colour_is_left_out_and_said() -> None:
    found = read("scan.ptx", two_stations(CLOUD, (False, True)))
    assert len(found) == len(CLOUD) / 2
    assert codes_of(found) == ["scans_without_color"]
    with pytest.raises(ScanContentError, match="no colour"):
        read("scan.ptx", two_stations(CLOUD, (False, False)))


def test_a_file_cut_short_is_damaged_wherever_it_ends() -> None:
    lines = two_stations(CLOUD).splitlines(keepends=True)
    for num_lines, said in ((30, "announces 30 points, but the file ends after 20"), (44, "header of a station")):
        with pytest.raises(ScanDamagedError, match=said):
            read("scan.ptx", "".join(lines[:num_lines]))
    del lines[15]
    with pytest.raises(ScanDamagedError, match="Line 40 has 1 values, expected 7"):
        read("scan.ptx", "".join(lines))


def test_absurd_counts_are_refused_before_anything_is_read() -> None:
    text = two_stations(CLOUD).replace("30\n1\n", "4000000\n4000000\n", 1)
    with pytest.raises(ScanTooLargeError, match="at most 200,000,000 points"):
        read("scan.ptx", text)
    with pytest.raises(ScanTooLargeError, match="at most 40 points, got 60"):
        read("scan.ptx", two_stations(CLOUD), max_points=40)


@pytest.mark.parametrize("matrix_line", ["0 0 0 0", "nan 0 0 0", "1 0 0 7"])
def test_a_matrix_that_is_no_pose_is_refused(matrix_line: str) -> None:
    lines = two_stations(CLOUD).splitlines()
    lines[6] = matrix_line
    with pytest.raises(ScanDamagedError, match="not a pose"):
        read("scan.ptx", "\n".join(lines))


@pytest.mark.parametrize("row", ["1 2 3 0.5 1 2", "1 2"])
def test_a_point_with_other_columns_is_named_with_its_line(row: str) -> None:
    lines = two_stations(CLOUD).splitlines()
    lines[10] = row
    with pytest.raises(ScanDamagedError, match="Line 11 has"):
        read("scan.ptx", "\n".join(lines))
