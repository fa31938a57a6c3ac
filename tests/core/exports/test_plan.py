"""Plans stand where the map lies, for the readers of CAD and GIS: ezdxf, and GDAL in rasterio."""

from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from rasterio.transform import rowcol, xy

from panoloc.core.earth.geopose import Georeference, earth_pose
from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.exports.wall_lines import wall_lines
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.ply.writer import write_ply
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.exports.tours import written

WIDTH, DEPTH, DOOR = 5.0, 3.5, (2.0, 2.9)
UTM = np.array([431_250.0, 5_312_480.0, 412.0])
SVG = "{http://www.w3.org/2000/svg}"


def room(height_m: float = 0.0) -> np.ndarray:
    """Return noisy points of the walls and the floor of a room at the origin, with a door in the wall along y = 0."""
    random = np.random.default_rng(3)
    along, up = random.uniform(0, 1, 40_000), random.uniform(0, 2.5, 40_000)
    side = random.integers(0, 4, 40_000)
    x = np.choose(side, [along * WIDTH, along * WIDTH, np.zeros(40_000), np.full(40_000, WIDTH)])
    y = np.choose(side, [np.zeros(40_000), np.full(40_000, DEPTH), along * DEPTH, along * DEPTH])
    walls = np.stack([x, y, up], axis=1)[~((side == 0) & (x > DOOR[0]) & (x < DOOR[1]))]
    floor = random.uniform(0, 1, (20_000, 3)) * [WIDTH, DEPTH, 0]
    return np.concatenate([walls, floor]) + random.normal(0, 0.004, (len(walls) + 20_000, 3)) + [0, 0, height_m]


def tour_in(folder: Path, offset: np.ndarray, levels: tuple[float, ...] = (0.0,), **place: Any) -> Tour:
    points = np.concatenate([room(level) for level in levels])
    colors = np.full((len(points), 3), 200, np.uint8)
    write_ply(folder / "scan.ply", PointCloud(points.astype(np.float32), colors, origin_offset=offset))
    photos = tuple(
        PlacedPhoto(f"a & b {number}.jpg", Pose(np.eye(3), offset + np.array([1.0, 2.0, level + 1.5])), 64, 32)
        for number, level in enumerate(levels)
    )
    heights = tuple(float(offset[2]) + level for level in levels)
    return replace(Tour("map_1", photos, scan=folder / "scan.ply", floor_levels_m=heights), **place)


def test_walls_become_lines_and_a_door_stays_open() -> None:
    points = room()
    cut = points[np.abs(points[:, 2] - 1.2) < 0.2, :2]
    lines, rest = wall_lines(cut)
    assert len(lines) == 5
    assert len(rest) < 0.02 * len(cut)
    ends = lines.reshape(-1, 2)
    corners = [(0, 0), (WIDTH, 0), (WIDTH, DEPTH), (0, DEPTH), (DOOR[0], 0), (DOOR[1], 0)]
    for corner in corners:
        assert np.hypot(*(ends - corner).T).min() < 0.04, corner
    off = [
        min(abs(y), abs(y - DEPTH)) if abs(b[0] - a[0]) > 0.3 else min(abs(x), abs(x - WIDTH))
        for a, b in lines
        for x, y in (a, b)
    ]
    assert max(off) < 0.01


def test_scattered_points_make_hardly_any_walls() -> None:
    lines, rest = wall_lines(np.random.default_rng(1).uniform(0, 5, (600, 2)))
    assert len(lines) <= 2  # 600 points in 25 m² are close to a line of half a metre here and there
    assert len(rest) > 500


def test_a_drawing_for_cad_has_survey_coordinates_layers_per_floor_and_names(tmp_path: Path) -> None:
    tour = tour_in(tmp_path, UTM, levels=(0.0, 3.1), coordinate_system="EPSG:25832")
    out = written("plan", tour, tmp_path / "out")
    drawing = ezdxf.readfile(out / "plan.dxf")  # type: ignore[attr-defined]
    assert not drawing.audit().has_errors
    assert drawing.header["$INSUNITS"] == 6
    for number, level in ((1, 0.0), (2, 3.1)):
        walls = [line.dxf for line in drawing.modelspace().query(f'LINE[layer=="FLOOR-{number}-WALLS"]')]
        assert len(walls) == 5
        ends = np.array([end for line in walls for end in (line.start, line.end)])
        assert np.abs(ends.min(axis=0) - UTM - [0, 0, level]).max() < 0.02
        assert np.abs(ends.max(axis=0) - UTM - [WIDTH, DEPTH, level]).max() < 0.02
        (text,) = drawing.modelspace().query(f'TEXT[layer=="FLOOR-{number}-PHOTOS"]')
        assert text.dxf.text == f"a & b {number - 1}.jpg"
        (place,) = drawing.modelspace().query(f'POINT[layer=="FLOOR-{number}-PHOTOS"]')
        np.testing.assert_allclose(place.dxf.location, UTM + np.array([1, 2, level + 1.5]), atol=1e-9)
        (arrow,) = drawing.modelspace().query(f'LINE[layer=="FLOOR-{number}-PHOTOS"]')
        np.testing.assert_allclose(arrow.dxf.end - arrow.dxf.start, [0.6, 0, 0], atol=1e-6)


def test_drawings_of_a_grid_in_feet_are_in_feet(tmp_path: Path) -> None:
    foot = 1200 / 3937
    out = written("plan", tour_in(tmp_path, UTM, coordinate_system="EPSG:2230"), tmp_path / "out")
    drawing = ezdxf.readfile(out / "plan.dxf")  # type: ignore[attr-defined]
    assert drawing.header["$INSUNITS"] == 21
    (place,) = drawing.modelspace().query('POINT[layer=="FLOOR-1-PHOTOS"]')
    np.testing.assert_allclose(place.dxf.location, (UTM + np.array([1, 2, 1.5])) / foot, atol=1e-6)
    with rasterio.open(out / "plan-1.tif") as picture:
        assert picture.crs.to_epsg() == 2230
        assert picture.bounds.left < UTM[0] / foot < picture.bounds.right
    # A drawing at 1 : 100 is in metres all the same.
    page = ElementTree.parse(out / "plan-1.svg").getroot()
    assert 50 < float(page.attrib["width"].removesuffix("mm")) < 80


@pytest.mark.parametrize(
    "place", [{"coordinate_system": "EPSG:25832"}, {"georeference": Georeference(48.1, 11.5, 520.0, 33.0)}, {}]
)
def test_a_wall_in_the_picture_lies_where_it_lies_on_earth(place: dict[str, Any], tmp_path: Path) -> None:
    offset = UTM if "coordinate_system" in place else np.zeros(3)
    tour = tour_in(tmp_path, offset, **place)
    with rasterio.open(written("plan", tour, tmp_path / "out") / "plan-1.tif") as picture:
        bands, transform, system = picture.read(), picture.transform, picture.crs
    corner = offset + np.array([WIDTH, DEPTH, 0])
    expected = corner[:2]
    if "georeference" in place:
        found = earth_pose(tour.georeference, Pose(np.eye(3), corner))  # type: ignore[arg-type]
        to_grid = Transformer.from_crs("EPSG:4326", system.to_wkt(), always_xy=True)
        expected = np.array(to_grid.transform(found.longitude_deg, found.latitude_deg))
        assert abs(np.hypot(*expected) - np.hypot(*corner[:2])) < 1e-3
    row, column = rowcol(transform, *expected)
    around = bands[:, row - 3 : row + 4, column - 3 : column + 4]
    # The section is dark, and beyond the wall nothing was scanned.
    assert (around[0] < 60).any()
    rows, columns = np.nonzero(bands[3])
    if "georeference" not in place:
        east, north = xy(transform, rows.min(), columns.max(), offset="ur")
        assert np.abs(np.array([east, north]) - corner[:2]).max() < 0.06


def test_a_drawing_for_people_has_walls_and_named_photos(tmp_path: Path) -> None:
    out = written("plan", tour_in(tmp_path, UTM), tmp_path / "out")
    page = ElementTree.parse(out / "plan-1.svg").getroot()
    (walls,) = [group for group in page.iter(f"{SVG}g") if group.get("id") == "walls"]
    assert walls[0].attrib["d"].count("M") == 5
    (photo,) = [group for group in page.iter(f"{SVG}g") if "data-x" in group.attrib]
    assert photo.findtext(f"{SVG}title") == "a & b 0.jpg"
    assert (float(photo.attrib["data-x"]), float(photo.attrib["data-y"])) == (UTM[0] + 1, UTM[1] + 2)


def test_a_plan_without_a_scan_shows_the_photos(tmp_path: Path) -> None:
    tour = replace(tour_in(tmp_path, UTM), scan=None, floor_levels_m=())
    out = written("plan", tour, tmp_path / "out")
    assert (out / "plan-1.svg").read_text().count("<title>") == 2
