"""In every reader a pixel shows what lies there in the map: 24 points near each of photos turned every way, on grids of every kind."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pycolmap
import pytest
from pyproj import CRS, Geod, Transformer

from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import ExportFormat
from tests.core.exports.readers import GL, READERS, Poses, about_x, about_y, about_z
from tests.core.exports.tours import GEOREFERENCE, HEIGHT, WIDTH, directions, jpeg, rotation_of, written

LIMIT_DEG = 0.7
DISTANCE_M = 1.6
TURNS = [(0, 0, 0), (37.5, -12.25, 4.75), (200, 62, -35), (301, -88, 10), (120, 15, 170), (5, 90, 0), (77, 3, -90)]


@dataclass(frozen=True)
class Place:
    """Where a map lies. at: of its photos, metres."""

    at: tuple[float, float, float]
    system: str | None = None
    undulation_m: float | None = None


PLACES = {
    "local": Place((1.0, -2.0, 1.5)),
    "UTM": Place((691_250.25, 5_334_480.5, 520.0), "EPSG:25832"),
    "compound": Place((691_250.25, 5_334_480.5, 520.0), "EPSG:25832+7837", 46.2),
    "feet": Place((1_914_400.0, 563_900.0, 20.0), "EPSG:2230"),
    "feet with heights": Place((1_914_400.0, 563_900.0, 20.0), "EPSG:2230+6360", -35.0),
}


def tour_of(place: Place, folder: Path) -> Tour:
    (folder / "photo").write_bytes(jpeg())
    photos = (
        PlacedPhoto(
            f"{number}.jpg",
            Pose(rotation_of(*turns), np.array(place.at) + np.array([3.0, 0.7, 0.1]) * number),
            WIDTH,
            HEIGHT,
            image=folder / "photo",
        )
        for number, turns in enumerate(TURNS)
    )
    given = {"coordinate_system": place.system, "geoid_undulation_m": place.undulation_m}
    return Tour("map_1", tuple(photos), georeference=None if place.system else GEOREFERENCE, **given)  # type: ignore[arg-type]


def seen(photo: PlacedPhoto, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points of the map (24, 3), and column and row (24, 2) as shares of the photo where it shows them."""
    wanted = directions(number)
    x, y, z = (wanted @ photo.map_from_camera.rotation).T
    shares = np.stack([0.5 - np.arctan2(y, x) / (2 * np.pi), 0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi], axis=1)
    return photo.map_from_camera.position + DISTANCE_M * wanted, shares


def rays(shares: np.ndarray) -> np.ndarray:
    """Return directions (n, 3) forward, left, up of pixels."""
    azimuth, elevation = np.pi * (1 - 2 * shares[:, 0]), np.pi * (0.5 - shares[:, 1])
    return np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )


def apart_deg(some: np.ndarray, others: np.ndarray) -> float:
    some, others = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (some, others))
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(some - others, axis=1) / 2)).max())


def metashape_of_nerfstudio(folder: Path) -> Poses:
    """What nerfstudio's `metashape_to_json` makes of cameras.xml: its world has axes z, x, y of the chunk, its cameras those of OpenGL."""
    chunk = ElementTree.parse(folder / "cameras.xml").getroot()[0]
    sensors = {sensor.get("id"): sensor.get("type") for sensor in chunk.iterfind("sensors/sensor")}
    found = {}
    for camera in chunk.iterfind("cameras/camera"):
        assert sensors[camera.get("sensor_id")] == "spherical"
        transform = np.array([float(value) for value in (camera.findtext("transform") or "").split()]).reshape(4, 4)
        transform = transform[[2, 0, 1, 3], :]
        transform[:, 1:3] *= -1
        world = transform[[1, 2, 0]]  # and back to the chunk
        found[f"{camera.get('label')}.jpg"] = Pose(world[:3, :3] @ GL, world[:3, 3])
    return found


MAP_READERS: dict[ExportFormat, Callable[[Path], Poses]] = {
    **{name: READERS[name] for name in ("gltf", "e57", "nerfstudio", "navvis")},
    "metashape": metashape_of_nerfstudio,
}


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("name", MAP_READERS)
def test_poses_show_points_of_the_map_where_they_are(name: ExportFormat, place: Place, tmp_path: Path) -> None:
    tour = tour_of(place, tmp_path)
    found = MAP_READERS[name](written(name, tour, tmp_path / "out"))
    for number, photo in enumerate(tour.photos):
        points, shares = seen(photo, number)
        pose = found[photo.name]
        assert apart_deg(rays(shares) @ pose.rotation.T, points - pose.position) < LIMIT_DEG, photo.name


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_colmap_projects_points_of_the_map_to_their_pixels(place: Place, tmp_path: Path) -> None:
    tour = tour_of(place, tmp_path)
    model = pycolmap.Reconstruction(written("colmap", tour, tmp_path / "out"))
    images: dict[str, Any] = {image.name: image for image in model.images.values()}
    for number, photo in enumerate(tour.photos):
        points, shares = seen(photo, number)
        pixels = np.array([images[photo.name].project_point(point) for point in points])
        assert apart_deg(rays(pixels / [WIDTH, HEIGHT]), rays(shares)) < LIMIT_DEG, photo.name


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_potree_turns_its_sphere_so_that_it_shows_points_where_they_are(place: Place, tmp_path: Path) -> None:
    """The sphere of three.js, whose texture `Images360` mirrors, turned by Euler angles in the order ZYX."""
    tour = tour_of(place, tmp_path)
    rows = (written("potree", tour, tmp_path / "out") / "coordinates.txt").read_text().splitlines()[1:]
    for number, (photo, row) in enumerate(zip(tour.photos, rows, strict=True)):
        points, shares = seen(photo, number)
        x, y, z, course, pitch, roll = map(float, row.split("\t")[2:])
        around, down = 2 * np.pi * (1 - shares[:, 0]), np.pi * shares[:, 1]
        vertices = np.stack([-np.cos(around) * np.sin(down), np.cos(down), np.sin(around) * np.sin(down)], axis=1)
        turned = about_z(np.radians(90 - course)) @ about_y(np.radians(-pitch)) @ about_x(np.radians(roll + 90))
        assert apart_deg(vertices @ turned.T, points - [x, y, z]) < LIMIT_DEG, photo.name


def true_directions(system: str, here: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return east, north, up (n, 3) of points of a grid, in metres, by geodesics."""
    grid = CRS(system).sub_crs_list[0] if CRS(system).is_compound else CRS(system)
    to_earth, unit = Transformer.from_crs(grid, "EPSG:4326", always_xy=True), grid.axis_info[0].unit_conversion_factor
    places = [to_earth.transform(*(point[:2] / unit)) for point in (here, *points)]
    found = []
    for place, point in zip(places[1:], points, strict=True):
        azimuth, _, apart = Geod(ellps="WGS84").inv(*places[0], *place)
        found.append([apart * np.sin(np.radians(azimuth)), apart * np.cos(np.radians(azimuth)), point[2] - here[2]])
    return np.array(found)


@pytest.mark.parametrize(
    "place", [place for place in PLACES.values() if place.system], ids=[name for name in PLACES if PLACES[name].system]
)
@pytest.mark.parametrize("name", ["gpano", "geojson", "opensfm"])
def test_formats_of_places_on_earth_show_points_in_their_true_directions(
    name: ExportFormat, place: Place, tmp_path: Path
) -> None:
    assert place.system is not None
    tour = tour_of(place, tmp_path)
    found = READERS[name](written(name, tour, tmp_path / "out"))
    for number, photo in enumerate(tour.photos):
        points, shares = seen(photo, number)
        expected = true_directions(place.system, photo.map_from_camera.position, points)
        assert apart_deg(rays(shares) @ found[photo.name].rotation.T, expected) < LIMIT_DEG, photo.name
