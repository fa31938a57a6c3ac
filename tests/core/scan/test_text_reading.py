"""Tables of numbers: XYZ, TXT, CSV and PTS in the shapes that programs export."""

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError, ScanFormatError
from tests.core.scan.scan_files import CLOUD, assert_same_points, codes_of, read, table_of


@pytest.mark.parametrize(
    ("name", "separator", "scale"),
    [("a.xyz", " ", None), ("a.txt", "\t", 1 / 255), ("a.csv", ",", None), ("a.asc", ";", 1 / 255), ("a", ", ", None)],
)
def test_separators_and_both_colour_ranges(name: str, separator: str, scale: float | None) -> None:
    assert_same_points(read(name, table_of(CLOUD, separator, scale)))


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
def test_a_header_line_names_the_columns(header: str, separator: str, between: str, after: str) -> None:
    text = header + table_of(CLOUD, separator, between=between, after=after)
    assert_same_points(read("scan.txt", text))


@pytest.mark.parametrize(
    ("between", "after"), [("", "0.25"), ("-1613", ""), ("0.1 0.2 -0.9", ""), ("", "0.1 0.2 -0.9"), ("-1 -2", "")]
)
def test_columns_without_names_are_found_by_their_values(between: str, after: str) -> None:
    found = read("scan.xyz", table_of(CLOUD, between=between, after=after))
    assert_same_points(found)
    assert "columns_chosen" in codes_of(found)


@pytest.mark.parametrize("intensity", ["-1613", "77", "0.5"])
def test_pts_has_a_count_and_an_intensity_before_the_colour(intensity: str) -> None:
    body = table_of(CLOUD, between=intensity)
    assert_same_points(read("scan.pts", f"{len(CLOUD)}\n{body}"))
    assert_same_points(read("scan.pts", body))
    halves = body.splitlines(keepends=True)
    two_scans = "25\n" + "".join(halves[:25]) + "35\n" + "".join(halves[25:])
    assert_same_points(read("scan.pts", two_scans))


def test_decimal_commas_are_understood() -> None:
    text = table_of(CLOUD, ";").replace(".", ",")
    assert_same_points(read("scan.csv", text))
    assert_same_points(read("scan.txt", text.replace(";", " ")))


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_line_ends_byte_order_mark_comments_and_blank_lines(newline: str) -> None:
    lines = table_of(CLOUD).splitlines()
    text = newline.join(["", *lines[:5], "# a remark", "", "// another", *lines[5:]])
    assert_same_points(read("scan.xyz", b"\xef\xbb\xbf" + text.encode()))


def test_missing_values_are_dropped_and_counted() -> None:
    lines = table_of(CLOUD).splitlines()
    lines[3] = "nan nan nan 1 2 3"
    lines[9] = "-nan(ind) 1.#QNAN inf 1 2 3"
    found = read("scan.xyz", "\n".join(lines))
    assert len(found) == 58
    assert "2 of 60 points were dropped" in found.diagnostics[0].message


def with_line(line: str) -> str:
    """Return the table of CLOUD with another line 42."""
    lines = table_of().splitlines()
    lines[41] = line
    return "\n".join(lines)


REFUSED: dict[str, tuple[str, type[ScanError], str]] = {
    **{
        f"{columns} columns": ("1 2 3 4 5"[: 2 * columns - 1] + "\n", ScanContentError, f"no colour.*{columns} columns")
        for columns in (3, 4, 5)
    },
    "normals": ("1 2 3 0.1 -0.2 0.9\n2 3 4 -0.5 0.1 0.8\n", ScanContentError, "no colour"),
    "a short line": (with_line("1 2 3 4 5"), ScanDamagedError, "Line 42 .*has 5 values"),
    "a word": (with_line("1 2 3 4 5 blue"), ScanDamagedError, "Line 42 .*not a number"),
    "two points in a number": (with_line("1 2 3 4 5 6.7.8"), ScanDamagedError, "Line 42 .*not a number"),
    "a line without an end": (
        "0 0 0 1 2 3\n1 1 1 4 5 6\n" + "1.5 " * 3_000_000,
        ScanDamagedError,
        "Line 3 is longer than",
    ),
    "prose": (
        "The scan of the third floor.\nTaken on 3 May 2024.\n" * 200,
        ScanFormatError,
        "no line of its first 100 holds three or more numbers",
    ),
    "a header without colour": ("x,y,z,intensity\n1,2,3,4\n", ScanContentError, "no colour.*x y z intensity"),
    "a header with a colour twice": ("x,y,z,r,g,b,red\n1,2,3,4,5,6,7\n", ScanFormatError, "2 columns red"),
    "fewer points than announced": (f"61\n{table_of()}", ScanDamagedError, "announces 61 points, but holds 60"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_table_that_holds_no_coloured_points_or_is_damaged_is_refused_with_the_reason(kind: str) -> None:
    text, error, said = REFUSED[kind]
    with pytest.raises(error, match=said):
        read("scan.xyz", text)


@pytest.mark.slow
def test_a_file_of_many_blocks_keeps_every_line() -> None:
    rng = np.random.default_rng(3)
    values = np.column_stack([rng.integers(-9999, 9999, (200_000, 3)) / 1000, rng.integers(0, 256, (200_000, 3))])
    text = "\n".join("  ".join(f"{value:.7g}" for value in row) for row in values.tolist())
    cloud = read("scan.xyz", text)
    assert len(text) > 4_194_304  # more than one block
    np.testing.assert_allclose(cloud.positions, values[:, :3], atol=1e-5)
    np.testing.assert_array_equal(cloud.colors, values[:, 3:])
