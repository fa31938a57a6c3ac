"""Coordinate systems that LAS, LAZ and E57 files name."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from laspy.vlrs.known import GeoKeyDirectoryVlr, WktCoordinateSystemVlr
from pye57 import E57, libe57
from pyproj import CRS

from panoloc.core.errors import ScanContentError
from panoloc.core.options import Unit, UnitChoice, UpAxis
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.scan.mesh_files import zip_of
from tests.core.scan.scan_files import CLOUD, las_of, read

UTM_32 = "EPSG:25832"
PLACE = np.array([640_000.0, 5_320_000.0, 500.0])


def las_at(
    cloud: PointCloud,
    wkt: str | None = None,
    keys: list[int] | None = None,
    minor: int = 4,
    scale: float = 1.0,
    place: np.ndarray = PLACE,
) -> bytes:
    """Return a LAZ file that lies at a place. keys: of GeoTIFF, four numbers each."""
    vlrs: list[Any] = [] if wkt is None else [WktCoordinateSystemVlr(wkt)]
    if keys is not None:
        vlrs.append(GeoKeyDirectoryVlr())
        vlrs[-1].parse_record_data(np.array([1, 1, 0, len(keys) // 4, *keys], "<u2").tobytes())
    positions = (cloud.positions * scale).astype(np.float32)
    placed = replace(cloud, positions=positions, origin_offset=place * scale)
    return las_of(placed, 7 if minor == 4 else 3, vlrs=tuple(vlrs), minor=minor)


def notes_of(cloud: PointCloud) -> dict[str, str]:
    return {note.code: note.message for note in cloud.diagnostics}


@pytest.mark.parametrize(
    ("named", "expected"),
    [
        ({"wkt": CRS(UTM_32).to_wkt("WKT1_GDAL")}, UTM_32),
        ({"keys": [1024, 0, 1, 1, 3072, 0, 1, 25832], "minor": 2}, UTM_32),
        ({"keys": [3072, 0, 1, 25832, 4096, 0, 1, 5783], "minor": 2}, "EPSG:5555"),
        ({"keys": [3072, 0, 1, 32767], "minor": 2}, None),
        ({}, None),
    ],
)
def test_a_las_file_names_it_by_wkt_or_by_keys(named: dict[str, Any], expected: str | None) -> None:
    found = read("scan.laz", las_at(CLOUD, **named))
    assert found.coordinate_system == expected
    np.testing.assert_allclose(found.positions + found.origin_offset, CLOUD.positions + PLACE, atol=1e-3)
    message = notes_of(found).get("coordinate_system", "")
    assert ("+1.396 degrees clockwise from true north" in message) == (expected is not None)


SURVEY_FOOT = 1200 / 3937


@pytest.mark.parametrize("unit", ["auto", "ft", "us-ft"])
@pytest.mark.parametrize(
    ("system", "height_foot"), [("EPSG:2230", SURVEY_FOOT), ("EPSG:2230+6360", SURVEY_FOOT), ("EPSG:2230+5703", 1.0)]
)
def test_a_grid_in_survey_feet_is_read_in_survey_feet_and_its_heights_in_their_own_unit(
    unit: UnitChoice, system: str, height_foot: float
) -> None:
    place = np.array([6_280_000.0, 1_840_000.0, 400.0])  # feet in San Diego, where international ones are 4 m away
    scan = las_of(replace(CLOUD, origin_offset=place), 7, vlrs=(WktCoordinateSystemVlr(CRS(system).to_wkt()),), minor=4)
    found = read("scan.laz", scan, unit=unit)
    expected = (CLOUD.positions + place) * [SURVEY_FOOT, SURVEY_FOOT, height_foot]
    np.testing.assert_allclose(found.positions + found.origin_offset, expected, atol=1e-3)
    assert found.coordinate_system is not None
    assert "32.71180, -117.16569" in notes_of(found)["coordinate_system"]
    assert found.read_as is not None
    assert found.read_as.unit == "us-ft"


def test_a_system_that_is_given_says_which_feet_a_scan_is_in() -> None:
    found = read("scan.ply", encode_ply(CLOUD), unit="ft", coordinate_system="EPSG:2230")
    np.testing.assert_allclose(found.positions, CLOUD.positions * SURVEY_FOOT, rtol=3e-7)


@pytest.mark.parametrize("key", [9001, 9002, 9003])
def test_a_las_file_without_a_system_may_name_its_units_by_keys(key: int) -> None:
    found = read("scan.laz", las_at(CLOUD, keys=[3076, 0, 1, key, 4099, 0, 1, 9001], minor=2))
    foot = {9001: 1.0, 9002: 0.3048, 9003: SURVEY_FOOT}[key]
    expected = (CLOUD.positions + PLACE) * [foot, foot, 1.0]
    np.testing.assert_allclose(found.positions + found.origin_offset, expected, atol=2e-3)


@pytest.mark.parametrize("text", [CRS(UTM_32).to_wkt(), UTM_32, ""])
def test_an_e57_file_names_it_in_its_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    path = tmp_path / "scan.e57"
    # pye57 writes an empty text there, which cannot be changed afterwards.
    made = libe57.StringNode
    monkeypatch.setattr(libe57, "StringNode", lambda image_file, value: made(image_file, value or text))
    file = E57(str(path), mode="w")
    monkeypatch.undo()
    data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), CLOUD.positions.astype(np.float64).T, strict=True))
    data |= dict(zip(("colorRed", "colorGreen", "colorBlue"), CLOUD.colors.T, strict=True))
    file.write_scan_raw(data, translation=PLACE)
    file.close()
    assert read_scan(path).coordinate_system == (UTM_32 if text else None)


@pytest.mark.parametrize(
    ("wkt", "unit", "up_axis", "scale", "said"),
    [
        (CRS(4326).to_wkt(), "m", "z", 1.0, "no lengths on a grid"),
        ("PROJCS[nonsense", "m", "z", 1.0, "expected a projected coordinate system"),
        (CRS(UTM_32).to_wkt(), "m", "y", 1.0, "the given up axis"),
        (CRS(UTM_32).to_wkt(), "ft", "z", 1 / 0.3048, "its unit is 1 m, but the given unit is ft"),
        (
            CRS(2263).to_wkt(),
            "m",
            "z",
            1.0,
            "its unit is 0.3048006 m, but the given unit is m; register the scan again",
        ),
    ],
)
def test_what_cannot_be_used_is_said_and_the_scan_is_read(
    wkt: str, unit: Unit, up_axis: UpAxis, scale: float, said: str
) -> None:
    found = read("scan.laz", las_at(CLOUD, wkt, scale=scale), unit=unit, up_axis=up_axis)
    assert found.coordinate_system is None
    assert said in notes_of(found)["coordinate_system_unused"]
    assert len(found) == len(CLOUD)


@pytest.mark.parametrize(
    ("place", "is_used"),
    [
        (PLACE, True),
        (np.add(PLACE, (300_000.0, 0.0, 0.0)), True),  # beyond the zone, but within the country
        (np.add(PLACE, (4e6, 0.0, 0.0)), False),
        (np.zeros(3), False),  # coordinates of its own
    ],
)
def test_a_system_far_from_the_scan_is_not_used_whoever_names_it(place: np.ndarray, is_used: bool) -> None:
    named = read("scan.laz", las_at(CLOUD, CRS(UTM_32).to_wkt(), place=place))
    given = read("scan.laz", las_at(CLOUD, place=place), coordinate_system=UTM_32)
    assert named.coordinate_system == (UTM_32 if is_used else None)
    for found in (named, given):
        assert ("lies outside its area" in notes_of(found).get("coordinate_system_unused", "")) != is_used


def test_scans_of_one_zip_are_in_one_system() -> None:
    one, same = las_at(CLOUD, CRS(UTM_32).to_wkt()), las_at(CLOUD, keys=[3072, 0, 1, 25832], minor=2)
    found = read("scans.zip", zip_of({"a.laz": one, "b.laz": same}))
    assert found.coordinate_system == UTM_32
    in_feet = las_at(CLOUD, CRS(2263).to_wkt(), scale=3937 / 1200, place=np.array([300_000.0, 60_000.0, 10.0]))
    feet = zip_of(dict.fromkeys(("a.laz", "b.laz"), in_feet))
    assert read("feet.zip", feet, unit="ft").coordinate_system == "EPSG:2263"
    other = las_at(CLOUD, CRS("EPSG:25833").to_wkt())
    with pytest.raises(
        ScanContentError, match=r"different coordinate systems \(a\.laz: EPSG:25832, b\.laz: EPSG:25833\)"
    ):
        read("scans.zip", zip_of({"a.laz": one, "b.laz": other}))


def test_a_scan_of_a_zip_that_names_no_system_is_said_to_be_in_that_of_the_others() -> None:
    named, silent = las_at(CLOUD, CRS(25832).to_wkt()), encode_ply(CLOUD)
    scan = read("scans.zip", zip_of({"a.ply": silent, "b.laz": named}))
    (said,) = [each for each in scan.diagnostics if each.code == "coordinate_system_assumed"]
    assert (scan.coordinate_system, said.severity) == ("EPSG:25832", "warning")
    assert said.message.startswith("a.ply has no usable coordinate system")
    alone = read("scans.zip", zip_of({"a.laz": named, "b.laz": named}))
    assert "coordinate_system_assumed" not in {found.code for found in alone.diagnostics}
