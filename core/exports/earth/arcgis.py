"""ArcGIS: the table of an oriented imagery dataset."""

import csv
import io
from collections.abc import Iterator

from panoloc.core.exports.angles import photo_angles
from panoloc.core.exports.earth.placing import grid_of, on_earth, time_text
from panoloc.core.exports.number_text import plain
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour

_WGS84 = 4326
_MAX_ROLL_DEG = 90.0
_COLUMNS = (
    "X",
    "Y",
    "Z",
    "SRS",
    "Name",
    "ImagePath",
    "AcquisitionDate",
    "CameraHeading",
    "CameraPitch",
    "CameraRoll",
    "HorizontalFieldOfView",
    "VerticalFieldOfView",
    "OrientedImageryType",
)


def why_not(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be written, None when it can. The turn of a map about its vertical changes no roll."""
    roll_deg = photo_angles(photo.map_from_camera.rotation).roll_deg
    if abs(roll_deg) <= _MAX_ROLL_DEG:
        return None
    return f"its roll is {roll_deg:.0f} degrees; ArcGIS takes at most {_MAX_ROLL_DEG:g} to either side"


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `oriented_imagery.csv`: positions and headings in the map's grid, else in WGS 84 and from true north.

    Its pitch is 0 straight down, 90 at the horizon: 90 + elevation.
    """
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(_COLUMNS)
    grid = grid_of(tour)
    for photo, place, true_angles in on_earth(tour):
        angles = true_angles if grid is None else photo_angles(photo.map_from_camera.rotation)
        turns = angles.heading_deg, 90.0 + angles.elevation_deg, angles.roll_deg
        on_globe = [place.longitude_deg, place.latitude_deg, place.height_m]
        position = on_globe if grid is None else photo.map_from_camera.position.tolist()
        table.writerow(
            [
                *(plain(value, 12) for value in position),
                str(grid or _WGS84),
                photo.name,
                photo.name,
                time_text(tour, photo),
                *map(plain, turns),
                "360",
                "180",
                "360",
            ]
        )
    yield ExportedFile("oriented_imagery.csv", out.getvalue().encode())
