"""Maps in a projected coordinate system: grid angles where formats name the grid, true north where they do not."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS, Geod, Transformer

from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.formats import export, north_of
from panoloc.core.exports.tour import Tour
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import ExportFormat
from tests.core.exports.readers import GL, READERS, e57_document
from tests.core.exports.tours import GOLDEN, document_of, golden_tour, written

UTM = "EPSG:25832"
AT = np.array([291_250.25, 5_612_480.5, 212.75])
"""Near the western edge of the zone, where its north is off by two degrees."""
NEW_YORK = np.array([300_000.0, 61_000.0, 12.0])
"""Metres; the grid itself counts US survey feet."""


def utm_tour(folder: Path, system: str = UTM) -> Tour:
    tour = golden_tour(folder, georeference=None)
    photo = replace(tour.photos[0], map_from_camera=Pose(GOLDEN.rotation, AT))
    return replace(tour, photos=(photo,), coordinate_system=system)


def true_heading_deg() -> float:
    """Return the compass heading of what lies ten metres ahead on the grid, by geodesics alone."""
    to_earth = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True)
    ahead = AT[:2] + 10 * np.array([np.sin(np.radians(37.5)), np.cos(np.radians(37.5))])
    azimuth, _, _ = Geod(ellps="WGS84").inv(*to_earth.transform(*AT[:2]), *to_earth.transform(*ahead))
    return float(azimuth % 360)


def feature(name: ExportFormat, file: str, tour: Tour, folder: Path) -> dict[str, Any]:
    (found,) = document_of(name, tour, folder / name, file)["features"]
    return dict(found)


def test_headings_from_true_north_are_those_of_geodesics(tmp_path: Path) -> None:
    expected = true_heading_deg()
    assert abs(expected - 37.5) > 1.5
    properties = feature("geojson", "photos.geojson", utm_tour(tmp_path), tmp_path)["properties"]
    assert properties["heading_deg"] == pytest.approx(expected, abs=0.01)
    assert (properties["elevation_deg"], properties["roll_deg"]) == pytest.approx((-12.25, 4.75))
    (pose,) = READERS["gpano"](written("gpano", utm_tour(tmp_path), tmp_path / "gpano")).values()
    forward = pose.rotation[:, 0]
    assert np.degrees(np.arctan2(forward[0], forward[1])) % 360 == pytest.approx(expected, abs=0.01)


def test_heights_that_are_not_above_the_ellipsoid_are_no_heights_of_geojson(tmp_path: Path) -> None:
    at = feature("geojson", "photos.geojson", utm_tour(tmp_path), tmp_path)
    assert len(at["geometry"]["coordinates"]) == 2
    assert (at["properties"]["height_m"], at["properties"]["height_reference"]) == (212.75, "unknown")
    assert at["geometry"]["coordinates"] == pytest.approx([6.04, 50.62], abs=0.05)


def test_heights_of_geojson_are_raised_by_the_undulation_of_the_geoid(tmp_path: Path) -> None:
    for system in (UTM, "EPSG:25832+7837"):
        tour = replace(utm_tour(tmp_path, system), geoid_undulation_m=46.2)
        at = feature("geojson", "photos.geojson", tour, tmp_path)
        assert at["geometry"]["coordinates"][2] == pytest.approx(258.95, abs=1e-9)
        assert at["properties"]["height_reference"] == "ellipsoid"
        # The grid keeps its own heights.
        properties = feature("stac", "items.json", tour, tmp_path)["properties"]
        assert properties["pers:perspective_center"] == AT.tolist()


def test_stac_names_the_grid_and_has_its_angles(tmp_path: Path) -> None:
    properties = feature("stac", "items.json", utm_tour(tmp_path), tmp_path)["properties"]
    assert properties["pers:crs"] == 25832
    assert properties["pers:perspective_center"] == AT.tolist()
    assert [properties[f"pano:{name}"] for name in ("yaw", "pitch", "roll")] == pytest.approx([37.5, -12.25, 4.75])
    matrix = np.array(properties["pers:rotation_matrix"]).reshape(3, 3)
    np.testing.assert_allclose(matrix.T @ GL, GOLDEN.rotation, atol=1e-12)
    assert properties["view:azimuth"] == pytest.approx(true_heading_deg(), abs=0.01)


def test_arcgis_has_the_code_of_the_grid_and_its_angles(tmp_path: Path) -> None:
    table = written("arcgis", utm_tour(tmp_path), tmp_path / "arcgis") / "oriented_imagery.csv"
    (row,) = csv.DictReader(table.read_text().splitlines())
    assert row["SRS"] == "25832"
    assert [float(row[axis]) for axis in "XYZ"] == AT.tolist()
    angles = [float(row[f"Camera{name}"]) for name in ("Heading", "Pitch", "Roll")]
    assert angles == pytest.approx([37.5, 77.75, 4.75])


def test_a_grid_in_feet_is_written_in_wgs_84_because_positions_are_in_metres(tmp_path: Path) -> None:
    tour = utm_tour(tmp_path, "EPSG:2263")
    tour = replace(tour, photos=(replace(tour.photos[0], map_from_camera=Pose(GOLDEN.rotation, NEW_YORK)),))
    table = written("arcgis", tour, tmp_path / "arcgis") / "oriented_imagery.csv"
    (row,) = csv.DictReader(table.read_text().splitlines())
    to_earth = Transformer.from_crs("EPSG:2263", "EPSG:4326", always_xy=True)
    expected = to_earth.transform(*(NEW_YORK[:2] * 3937 / 1200))
    assert row["SRS"] == "4326"
    assert (float(row["X"]), float(row["Y"])) == pytest.approx(expected, abs=1e-9)
    assert "pers:crs" not in feature("stac", "items.json", tour, tmp_path)["properties"]
    assert north_of("arcgis", tour) == "true"


def test_a_grid_without_a_code_is_written_in_wgs_84(tmp_path: Path) -> None:
    local = (
        'PROJCS["local",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
        'UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],'
        'PARAMETER["central_meridian",9.1],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],'
        'PARAMETER["false_northing",0],UNIT["metre",1]]'
    )
    tour = utm_tour(tmp_path, local)
    properties = feature("stac", "items.json", tour, tmp_path)["properties"]
    assert "pers:crs" not in properties
    assert properties["pano:yaw"] == properties["view:azimuth"]
    assert properties["pano:yaw"] != pytest.approx(37.5, abs=1)
    assert north_of("stac", tour) == "true"


@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT2_2019"])
def test_a_grid_with_heights_is_written_with_the_code_of_its_grid(version: Any, tmp_path: Path) -> None:
    for code in ("EPSG:25832+7837", "EPSG:5555"):
        tour = utm_tour(tmp_path, CRS(code).to_wkt(version))
        table = written("arcgis", tour, tmp_path / "arcgis") / "oriented_imagery.csv"
        (row,) = csv.DictReader(table.read_text().splitlines())
        assert (row["SRS"], [float(row[axis]) for axis in "XYZ"]) == ("25832", AT.tolist())
        assert feature("stac", "items.json", tour, tmp_path)["properties"]["pers:crs"] == 25832


def two_photos(folder: Path, system: str, at: np.ndarray) -> Tour:
    """Return two photos ten metres apart along the grid's y axis, the second a metre higher."""
    tour = utm_tour(folder, system)
    places = {"a.jpg": at, "b.jpg": at + np.array([0, 10, 1])}
    photos = (
        replace(tour.photos[0], name=name, map_from_camera=Pose(GOLDEN.rotation, place))
        for name, place in places.items()
    )
    return replace(tour, photos=tuple(photos))


@pytest.mark.parametrize(("system", "at"), [(UTM, AT), ("EPSG:2263", NEW_YORK), ("EPSG:25832+7837", AT)])
def test_opensfm_has_an_origin_on_earth_and_shots_from_there(system: str, at: np.ndarray, tmp_path: Path) -> None:
    tour = two_photos(tmp_path, system, at)
    folder = written("opensfm", tour, tmp_path / "out")
    origin = json.loads((folder / "reference_lla.json").read_text())
    horizontal = CRS(system).sub_crs_list[0] if CRS(system).is_compound else CRS(system)
    to_earth = Transformer.from_crs(horizontal, "EPSG:4326", always_xy=True)
    unit = horizontal.axis_info[0].unit_conversion_factor
    here, there = (to_earth.transform(*(place[:2] / unit)) for place in (at, at + np.array([0, 10, 0])))
    assert (origin["longitude"], origin["latitude"]) == pytest.approx(here, abs=1e-9)
    assert origin["altitude"] == at[2]
    azimuth, _, apart = Geod(ellps="WGS84").inv(*here, *there)
    found = READERS["opensfm"](folder)
    east, north, up = found["b.jpg"].position - found["a.jpg"].position
    assert (np.degrees(np.arctan2(east, north)), np.hypot(east, north), up) == pytest.approx(
        (azimuth, apart, 1), abs=1e-3
    )
    # Forward is 37.5 degrees from the grid's north, which lies at the azimuth.
    ahead = found["a.jpg"].rotation[:, 0]
    assert np.degrees(np.arctan2(ahead[0], ahead[1])) == pytest.approx(37.5 + azimuth, abs=0.01)


def test_ros_has_places_on_earth_with_altitudes_above_the_ellipsoid_alone(tmp_path: Path) -> None:
    for undulation, altitude in ((None, None), (46.2, pytest.approx(258.95))):
        tour = replace(utm_tour(tmp_path, "EPSG:25832+7837"), geoid_undulation_m=undulation)
        (pose,) = document_of("ros", tour, tmp_path / str(undulation), "geo_poses.json")
        at = pose["message"]["pose"]["position"]
        assert (at["longitude"], at["latitude"]) == pytest.approx((6.04, 50.62), abs=0.05)
        assert at["altitude"] == altitude


@pytest.mark.parametrize("system", [UTM, "EPSG:25832+7837", "EPSG:2263", "EPSG:2230+6360"])
def test_an_e57_names_a_system_in_which_its_metres_are_right(system: str, tmp_path: Path) -> None:
    tour = two_photos(tmp_path, system, NEW_YORK)
    text = e57_document(written("e57", tour, tmp_path / "out") / "tour.e57").findtext("{*}coordinateMetadata")
    named, given = CRS(text), CRS(system)
    assert {axis.unit_name for axis in named.axis_info} == {"metre"}
    to_same = Transformer.from_crs(named, given, always_xy=True)
    factors = [axis.unit_conversion_factor for axis in given.axis_info] + [1.0]
    assert to_same.transform(*NEW_YORK) == pytest.approx(NEW_YORK / factors[:3], abs=1e-6)
    if system in (UTM, "EPSG:2263"):
        assert coordinate_system(named.to_wkt()).epsg == (25832 if system == UTM else 32118)


def test_an_e57_keeps_the_system_of_the_survey(tmp_path: Path) -> None:
    tour = two_photos(tmp_path, UTM, AT)
    survey = written("e57", tour, tmp_path / "survey") / "tour.e57"
    for copied, expected in (
        (replace(tour, coordinate_system=None, survey=survey), CRS(UTM)),
        (replace(tour, coordinate_system=None), None),
    ):
        file = written("e57", copied, tmp_path / str(expected is None)) / "tour.e57"
        text = e57_document(file).findtext("{*}coordinateMetadata")
        assert (CRS(text) if text else None) == expected


def test_every_format_says_that_it_means_the_grid(tmp_path: Path) -> None:
    tour = utm_tour(tmp_path)
    found = {
        name: north_of(name, tour)
        for name in ("potree", "navvis", "colmap", "opensfm", "stac", "arcgis", "gpano", "geojson")
    }
    assert {name for name, north in found.items() if north == "true"} == {"gpano", "geojson", "opensfm"}
    assert {north for name, north in found.items() if name not in ("gpano", "geojson", "opensfm")} == {"grid"}
    assert north_of("stac", replace(tour, georeference=golden_tour().georeference)) == "true"


def test_positions_outside_of_the_coordinate_system_are_refused(tmp_path: Path) -> None:
    tour = utm_tour(tmp_path)
    far = replace(tour.photos[0], map_from_camera=Pose(GOLDEN.rotation, np.array([9e9, 9e9, 0.0])))
    with pytest.raises(ExportRefusedError, match="which is outside"):
        list(export("geojson", replace(tour, photos=(far,))))
