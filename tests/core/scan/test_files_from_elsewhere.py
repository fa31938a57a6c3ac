"""Files that other programs wrote, where the folder with them is at hand."""

from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading import read_scan

FORMATS = Path(__file__).parents[3].parent / "shared" / "formats"
pytestmark = pytest.mark.skipif(not FORMATS.is_dir(), reason="the folder ../shared/formats is not there")


@pytest.mark.parametrize(
    ("name", "num_points", "mean_color"),
    [
        ("coloured-cube-float.e57", 7680, (85, 85, 85)),
        ("colour-representation.e57", 153, (83, 87, 85)),
        ("tiny-cartesian-rgb.e57", 2090, (131, 121, 113)),
        ("with-colour-1.2.las", 1065, (122, 111, 126)),
        ("with-colour.copc.laz", 1065, (122, 111, 126)),
        ("utm.pcd", 1065, (122, 111, 126)),
        ("large-coordinates-8bit-colour-in-16bit.laz", 110_000, (111, 120, 99)),
        ("with-colour.pts", 10, (102, 116, 92)),
        ("simple-ascii.pcd", 213, (68, 78, 88)),
    ],
)
def test_good_files_are_read_with_their_colours(name: str, num_points: int, mean_color: tuple[int, int, int]) -> None:
    cloud = read_scan(FORMATS / name)
    assert (len(cloud), cloud.num_points_read) == (num_points, num_points)
    np.testing.assert_allclose(cloud.colors.mean(axis=0), mean_color, atol=1)


def test_the_same_survey_in_two_formats_is_the_same_cloud() -> None:
    # One of them says that its heights are in feet, the other says nothing.
    names, as_written = ("with-colour-1.2.las", "with-colour.copc.laz"), ScanOptions(unit="m", height_unit="m")
    plain, indexed = (read_scan(FORMATS / name, as_written) for name in names)
    order = [np.lexsort((cloud.positions + cloud.origin_offset).T) for cloud in (plain, indexed)]
    np.testing.assert_allclose(
        (plain.positions + plain.origin_offset)[order[0]],
        (indexed.positions + indexed.origin_offset)[order[1]],
        atol=0.01,
    )


def test_survey_coordinates_get_an_offset_and_8_bit_colour_is_found() -> None:
    cloud = read_scan(FORMATS / "large-coordinates-8bit-colour-in-16bit.laz", ScanOptions(unit="m", height_unit="m"))
    np.testing.assert_allclose(cloud.origin_offset[:2], [636_590, 849_217])
    assert {"large_coordinates", "color_range"} <= {note.code for note in cloud.diagnostics}
    hundredths = (cloud.positions.astype(np.float64) + cloud.origin_offset) * 100
    assert np.abs(hundredths - np.rint(hundredths)).max() < 0.01  # the file's resolution is 1 cm; nothing is lost


def test_surveys_in_feet_are_read_in_metres() -> None:
    in_feet, heights_in_feet = (
        read_scan(FORMATS / name).read_as
        for name in ("large-coordinates-8bit-colour-in-16bit.laz", "with-colour.copc.laz")
    )
    assert in_feet is not None
    assert heights_in_feet is not None
    assert (in_feet.unit, in_feet.height_unit, in_feet.unit_from) == ("ft", "ft", "file")
    assert (heights_in_feet.unit, heights_in_feet.height_unit) == ("m", "us-ft")


@pytest.mark.parametrize(
    ("name", "error", "said"),
    [
        ("bad-crc.e57", ScanDamagedError, "checksum"),
        ("corrupt-crc.e57", ScanDamagedError, "checksum"),
        ("empty.e57", ScanContentError, "no points"),
        ("zero-points.e57", ScanContentError, "no points"),
        ("测试点云.e57", ScanContentError, "no points"),
        ("tiny-spherical.e57", ScanContentError, "no colour"),
        (
            "tiny-with-spherical-image-no-colour.e57",
            ScanContentError,
            "no colour .* and 4 images, but none that .* has a pose",
        ),
        ("indoor-all-zero-colour.laz", ScanContentError, r"\(0, 0, 0\)"),
        ("no-colour-ascii.ply", ScanContentError, "no colour"),
        ("no-vertex.ply", ScanContentError, "no points"),
    ],
)
def test_files_without_a_map_in_them_say_why(name: str, error: type[ScanError], said: str) -> None:
    with pytest.raises(error, match=said):
        read_scan(FORMATS / name)
