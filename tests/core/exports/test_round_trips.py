"""What is written is what is read: photos turned every way, by the readers of each format."""

from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from panoloc.core.earth.geopose import Georeference, earth_pose
from panoloc.core.exports.formats import EXPORTERS
from panoloc.core.exports.tour import Tour
from panoloc.core.options import FORMATS_ON_EARTH, ExportFormat
from tests.core.exports.readers import READERS
from tests.core.exports.tours import turned_tour, written

# Where a format says so: NavVis writes six decimals, readers of glTF hold single precision.
ROTATION_TOLERANCE = {"navvis": 4e-6, "gltf": 4e-7}
POSITION_TOLERANCE = {"gltf": 1e-4}
# A map that lies at the equator on the prime meridian and is 1,000 m wide at most, so that a plane is a plane within its tolerance.
PLACE = Georeference(52.0, 5.0, 40.0, 33.0)
WITHOUT_ROTATIONS: set[ExportFormat] = {"plan"}  # see test_plan.py
FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)


def georeferenced(tour: Tour) -> Tour:
    near = tuple(photo for number, photo in enumerate(tour.photos) if number % 2 == 0)
    return replace(tour, photos=near, georeference=PLACE)


def close(found: Any, expected: Any, tolerance: float) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)


def test_every_format_of_the_contract_has_a_writer_and_a_reader_that_checks_it() -> None:
    assert set(FORMATS) == set(EXPORTERS) == set(READERS) | WITHOUT_ROTATIONS


@pytest.mark.parametrize("name", [name for name in FORMATS if name not in FORMATS_ON_EARTH | WITHOUT_ROTATIONS])
def test_photos_turned_every_way_come_back_from_a_format_in_the_axes_of_the_map(
    name: ExportFormat, tmp_path: Path
) -> None:
    tour = turned_tour(tmp_path)
    if name == "colmap-rig":  # would cut six images of each
        tour = Tour(tour.name, tuple(replace(photo, image=None) for photo in tour.photos))
    if name == "gltf":  # no single precision holds those near the origin and those of the survey in one scene
        tour = Tour(tour.name, tour.photos[1::2])
    found = READERS[name](written(name, tour, tmp_path / "out"))
    assert len(found) == len(tour.photos)
    for photo in tour.photos:
        pose = found[photo.name if name != "metashape" else Path(photo.name).stem]
        close(pose.rotation, photo.map_from_camera.rotation, ROTATION_TOLERANCE.get(name, 1e-8))
        if not np.isnan(pose.position).any():
            close(pose.position, photo.map_from_camera.position, POSITION_TOLERANCE.get(name, 1e-6))


@pytest.mark.parametrize("name", [name for name in FORMATS if name in FORMATS_ON_EARTH])
def test_photos_turned_every_way_come_back_from_a_format_of_places_on_earth(name: ExportFormat, tmp_path: Path) -> None:
    tour = georeferenced(turned_tour(tmp_path, upright=name == "arcgis"))
    found = READERS[name](written(name, tour, tmp_path / "out"))
    assert len(found) == len(tour.photos)
    for photo in tour.photos:
        place = earth_pose(PLACE, photo.map_from_camera)
        close(found[photo.name].rotation, place.enu_from_camera, 1e-8)
        if not np.isnan(found[photo.name].position).any():
            at = place.longitude_deg, place.latitude_deg, place.height_m
            close(found[photo.name].position, at, 1e-9)


def test_a_reconstruction_of_opensfm_lies_in_east_north_and_up_where_the_map_has_a_georeference(tmp_path: Path) -> None:
    tour = georeferenced(turned_tour(tmp_path))
    found = READERS["opensfm"](written("opensfm", tour, tmp_path / "out"))
    for photo in tour.photos:
        place = earth_pose(PLACE, photo.map_from_camera)
        # East, north, up at the origin and at the camera, metres away, differ by less than this.
        close(found[photo.name].rotation, place.enu_from_camera, 1e-5)
