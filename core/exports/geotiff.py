"""A floor from above as a GeoTIFF: its pixels lie where the map lies (OGC 19-008r4)."""

import io
import math
from collections.abc import Iterator
from xml.sax.saxutils import escape

import numpy as np
from PIL import Image, TiffImagePlugin

from panoloc.core.earth.geopose import Georeference, turned_by
from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.exports.floor_plan import Array, FloorPicture
from panoloc.core.exports.tour import ExportedFile, Tour, text_file

_TRANSFORMATION, _KEYS, _DOUBLES = 34264, 34735, 34736
_SHORT, _DOUBLE = 3, 12  # types of TIFF
_USER_DEFINED, _METRE, _DEGREE, _WGS84, _TRANSVERSE_MERCATOR = 32767, 9001, 9102, 4326, 1


def geotiff(name: str, picture: FloorPicture, tour: Tour) -> Iterator[ExportedFile]:
    """Yield `NAME.tif` and its world file `NAME.tfw`; for a system without an EPSG code also `NAME.tif.aux.xml` with its WKT, for GDAL."""
    grid_from_pixel, keys, doubles, wkt = _placed(picture, tour)
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    rows = np.zeros((4, 4))
    rows[:2, [0, 1, 3]], rows[3, 3] = grid_from_pixel, 1
    given = ((_TRANSFORMATION, _DOUBLE, rows.ravel().tolist()), (_KEYS, _SHORT, keys), (_DOUBLES, _DOUBLE, doubles))
    for tag, kind, values in given:
        if values:
            tags.tagtype[tag] = kind
            tags[tag] = tuple(values)
    out = io.BytesIO()
    Image.fromarray(picture.pixels).save(out, "TIFF", tiffinfo=tags, compression="tiff_adobe_deflate")
    yield ExportedFile(f"{name}.tif", out.getvalue())
    # A world file names the middle of the first pixel.
    middle = grid_from_pixel @ [0.5, 0.5, 1.0]
    yield text_file(f"{name}.tfw", [repr(float(value)) for value in (*grid_from_pixel[:, :2].T.ravel(), *middle)])
    if wkt is not None:
        yield text_file(f"{name}.tif.aux.xml", [f"<PAMDataset><SRS>{escape(wkt)}</SRS></PAMDataset>"])


def _placed(picture: FloorPicture, tour: Tour) -> tuple[Array, list[int], list[float], str | None]:
    """Return the affine map (2, 3) from pixels (column, row, 1) to coordinates, keys of GeoTIFF with their numbers, and WKT or None."""
    step = 1 / picture.pixels_per_m
    metres = np.array([[step, 0, picture.left], [0, -step, picture.top]])
    if tour.georeference is not None:
        turn = turned_by(tour.georeference.heading_deg)[:2, :2]
        return turn @ metres, *_mercator_about(tour.georeference), None
    if tour.coordinate_system is None:
        return metres, [], [], None
    system = coordinate_system(tour.coordinate_system)
    placed = metres / system.metres_per_unit
    if system.epsg is None:
        return placed, [], [], tour.coordinate_system
    return placed, _directory((1024, 0, 1), (1025, 0, 1), (3072, 0, system.epsg)), [], None


def _mercator_about(place: Georeference) -> tuple[list[int], list[float]]:
    """Return keys of a transverse Mercator projection about the origin of a map: its metres there, and within a millionth 9 km around.

    The scale makes metres at the height of the map metres of the grid.
    """
    scale = 1 + place.height_m / _radius_m(place.latitude_deg)
    doubles = [place.longitude_deg, place.latitude_deg, 0.0, 0.0, 1 / scale]
    kept = [(key, _DOUBLES, number) for number, key in enumerate((3080, 3081, 3082, 3083, 3092))]
    keys = _directory(
        *((1024, 0, 1), (1025, 0, 1), (2048, 0, _WGS84), (2054, 0, _DEGREE), (3072, 0, _USER_DEFINED)),
        *((3074, 0, _USER_DEFINED), (3075, 0, _TRANSVERSE_MERCATOR), (3076, 0, _METRE)),
        *kept,
    )
    return keys, doubles


def _radius_m(latitude_deg: float) -> float:
    """Return the mean radius of curvature of WGS 84."""
    a, e2 = 6_378_137.0, 0.00669437999014
    return a * math.sqrt(1 - e2) / (1 - e2 * math.sin(math.radians(latitude_deg)) ** 2)


def _directory(*keys: tuple[int, int, int]) -> list[int]:
    """Return the directory of keys, each (id, tag of its value or 0, value or index in that tag)."""
    return [1, 1, 0, len(keys), *(value for key, tag, number in keys for value in (key, tag, 1, number))]
