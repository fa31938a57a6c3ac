"""Tables of numbers: XYZ, TXT, CSV and PTS in the shapes that programs export."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanFormatError
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan

ScanFile = Callable[[str, bytes | str], Path]
Compare = Callable[..., None]


def table(
    cloud: PointCloud, separator: str = " ", scale: float | None = None, between: str = "", after: str = ""
) -> str:
    colors = cloud.colors.tolist() if scale is None else (cloud.colors * scale).tolist()
    lines = []
    for position, color in zip(cloud.positions.tolist(), colors, strict=True):
        values = [f"{value:.3f}" for value in position] + between.split() + [str(value) for value in color]
        lines.append(separator.join(values + after.split()))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("name", "separator", "scale"),
    [("a.xyz", " ", None), ("a.txt", "\t", 1 / 255), ("a.csv", ",", None), ("a.asc", ";", 1 / 255), ("a", ", ", None)],
)
def test_separators_and_both_colour_ranges(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, name: str, separator: str, scale: float | None
) -> None:
    assert_same_points(read_scan(scan_file(name, table(cloud, separator, scale))), cloud)


@pytest.mark.parametrize(
    ("header", "separator", "between", "after"),
    [
        ("//X Y Z R G B\n60\n", " ", "", ""),
        ("X,Y,Z,Intensity,Red,Green,Blue\n", ",", "17", ""),
        ("# made by hand\n# x y z nx ny nz r g b\n\n", " ", "0.1 0.2 -0.9", ""),
        ('"x";"y";"z";"r";"g";"b";"label"\n', ";", "", "4"),
        ("x[m] y[m] z[m] scalar Rf Gf Bf\n", " ", "200", ""),
    ],
)
def test_a_header_line_names_the_columns(
    cloud: PointCloud,
    scan_file: ScanFile,
    assert_same_points: Compare,
    header: str,
    separator: str,
    between: str,
    after: str,
) -> None:
    text = header + table(cloud, separator, between=between, after=after)
    assert_same_points(read_scan(scan_file("scan.txt", text)), cloud)


@pytest.mark.parametrize(
    ("between", "after"), [("", "0.25"), ("-1613", ""), ("0.1 0.2 -0.9", ""), ("", "0.1 0.2 -0.9"), ("-1 -2", "")]
)
def test_columns_without_names_are_found_by_their_values(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, between: str, after: str
) -> None:
    read = read_scan(scan_file("scan.xyz", table(cloud, between=between, after=after)))
    assert_same_points(read, cloud)
    assert "columns_chosen" in [note.code for note in read.diagnostics]


@pytest.mark.parametrize("intensity", ["-1613", "77", "0.5"])
def test_pts_has_a_count_and_an_intensity_before_the_colour(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, intensity: str
) -> None:
    body = table(cloud, between=intensity)
    assert_same_points(read_scan(scan_file("scan.pts", f"{len(cloud)}\n{body}")), cloud)
    assert_same_points(read_scan(scan_file("scan.pts", body)), cloud)
    halves = body.splitlines(keepends=True)
    two_scans = "25\n" + "".join(halves[:25]) + "35\n" + "".join(halves[25:])
    assert_same_points(read_scan(scan_file("scan.pts", two_scans)), cloud)
    with pytest.raises(ScanDamagedError, match="announces 61 points, but holds 60"):
        read_scan(scan_file("scan.pts", f"61\n{body}"))


def test_decimal_commas_are_understood(cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare) -> None:
    text = table(cloud, ";").replace(".", ",")
    assert_same_points(read_scan(scan_file("scan.csv", text)), cloud)
    assert_same_points(read_scan(scan_file("scan.txt", text.replace(";", " "))), cloud)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_line_ends_byte_order_mark_comments_and_blank_lines(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Compare, newline: str
) -> None:
    lines = table(cloud).splitlines()
    text = newline.join(["", *lines[:5], "# a remark", "", "// another", *lines[5:]])
    assert_same_points(read_scan(scan_file("scan.xyz", b"\xef\xbb\xbf" + text.encode())), cloud)


def test_missing_values_are_dropped_and_counted(cloud: PointCloud, scan_file: ScanFile) -> None:
    lines = table(cloud).splitlines()
    lines[3] = "nan nan nan 1 2 3"
    lines[9] = "-nan(ind) 1.#QNAN inf 1 2 3"
    read = read_scan(scan_file("scan.xyz", "\n".join(lines)))
    assert len(read) == 58
    assert "2 of 60 points were dropped" in read.diagnostics[0].message


@pytest.mark.parametrize("columns", [3, 4, 5])
def test_too_few_columns_are_no_colour(scan_file: ScanFile, columns: int) -> None:
    with pytest.raises(ScanContentError, match=f"no colour.*{columns} columns"):
        read_scan(scan_file("scan.xyz", "1 2 3 4 5 6"[: 2 * columns - 1] + "\n"))


def test_normals_are_not_taken_for_colours(scan_file: ScanFile) -> None:
    with pytest.raises(ScanContentError, match="no colour"):
        read_scan(scan_file("scan.xyz", "1 2 3 0.1 -0.2 0.9\n2 3 4 -0.5 0.1 0.8\n"))


@pytest.mark.parametrize(
    ("damage", "said"),
    [("1 2 3 4 5", "has 5 values"), ("1 2 3 4 5 blue", "not a number"), ("1 2 3 4 5 6.7.8", "not a number")],
)
def test_a_line_that_does_not_fit_is_named(cloud: PointCloud, scan_file: ScanFile, damage: str, said: str) -> None:
    lines = table(cloud).splitlines()
    lines[41] = damage
    with pytest.raises(ScanDamagedError, match=rf"Line 42 .*{said}"):
        read_scan(scan_file("scan.xyz", "\n".join(lines)))


def test_a_line_without_an_end_is_refused_quickly(scan_file: ScanFile) -> None:
    start = "0 0 0 1 2 3\n1 1 1 4 5 6\n"
    with pytest.raises(ScanDamagedError, match=r"Line 3 is longer than"):
        read_scan(scan_file("scan.xyz", start + "1.5 " * 3_000_000))


def test_prose_is_not_a_scan(scan_file: ScanFile) -> None:
    with pytest.raises(ScanFormatError, match="no line of its first 100 holds three or more numbers"):
        read_scan(scan_file("notes.txt", "The scan of the third floor.\nTaken on 3 May 2024.\n" * 200))


def test_a_header_that_names_no_colour_is_said(scan_file: ScanFile) -> None:
    with pytest.raises(ScanContentError, match=r"no colour.*x y z intensity"):
        read_scan(scan_file("scan.csv", "x,y,z,intensity\n1,2,3,4\n"))
    with pytest.raises(ScanFormatError, match="2 columns red"):
        read_scan(scan_file("scan.csv", "x,y,z,r,g,b,red\n1,2,3,4,5,6,7\n"))


@pytest.mark.slow
def test_a_file_of_many_blocks_keeps_every_line(scan_file: ScanFile) -> None:
    rng = np.random.default_rng(3)
    values = np.column_stack([rng.integers(-9999, 9999, (200_000, 3)) / 1000, rng.integers(0, 256, (200_000, 3))])
    text = "\n".join("  ".join(f"{value:.7g}" for value in row) for row in values.tolist())
    cloud = read_scan(scan_file("scan.xyz", text))
    assert len(text) > 4_194_304  # more than one block
    np.testing.assert_allclose(cloud.positions, values[:, :3], atol=1e-5)
    np.testing.assert_array_equal(cloud.colors, values[:, 3:])
