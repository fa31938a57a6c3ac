"""Changes as CSV, and as GeoJSON (RFC 7946)."""

import csv
import io
import json
from typing import Any

from panoloc.core.changes.reports.report import ChangeReport

_COLUMNS = (
    "number", "id", "kind", "x_m", "y_m", "z_m", "width_m", "depth_m", "height_m", "from_x_m", "from_y_m", "from_z_m", "floor", "certainty",
    "is_sure", "photos", "first_seen_at", "last_seen_at", "grid", "grid_unit", "grid_east", "grid_north", "grid_height_m",
    "from_grid_east", "from_grid_north", "from_grid_height_m",
)  # fmt: skip
_ON_GRID = ("east", "north", "height_m")


def as_csv(report: ChangeReport) -> bytes:
    """Return one line per object, in metres of the map's own frame, and on its grid where it has one."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(_COLUMNS)
    for number, each in enumerate(report.objects, 1):
        before = each["from_m"] or ("", "", "")
        numbers = (*each["center_m"], *each["size_m"], *before)
        seen = each["num_photos"], each["first_seen_at"], each["last_seen_at"]
        floor = "" if each["floor"] is None else each["floor"]
        grid = (*_values(each["grid"], "name", "unit", *_ON_GRID), *_values(each["from_grid"], *_ON_GRID))
        writer.writerow(
            (number, each["id"], each["kind"], *numbers, floor, each["certainty"], int(each["is_sure"]), *seen, *grid)
        )
    return text.getvalue().encode()


def _values(grid: dict[str, Any] | None, *names: str) -> list[Any]:
    found = [None if grid is None else grid[name] for name in names]
    return [round(each, 4) if isinstance(each, float) else each for each in found]


def as_geojson(report: ChangeReport) -> bytes:
    """Return a feature per object: a point in WGS 84 (longitude, latitude, height) where the map's place on Earth is known.

    Elsewhere points are in metres of the map's own frame, which `crs_note` says: no other program takes them for degrees unasked.
    """
    document: dict[str, Any] = {"type": "FeatureCollection", "name": report.title}
    is_on_earth = all(each["wgs84"] for each in report.objects)
    if not is_on_earth:
        document["crs_note"] = (
            "Coordinates are metres in the map's own frame, not degrees: where the map is on Earth is unknown."
        )
    document["features"] = [_feature(each, is_on_earth) for each in report.objects]
    return json.dumps(document, indent=1).encode()


def _feature(each: dict[str, Any], is_on_earth: bool) -> dict[str, Any]:
    coordinates = _degrees(each["wgs84"]) if is_on_earth else each["center_m"]
    properties = {name: value for name, value in each.items() if name not in ("id", "wgs84")}
    point = {"type": "Point", "coordinates": coordinates}
    return {"type": "Feature", "id": each["id"], "geometry": point, "properties": properties}


def _degrees(place: dict[str, Any]) -> list[float]:
    """Return longitude, latitude and, where it is known, height above the ellipsoid."""
    degrees = [round(place["longitude_deg"], 9), round(place["latitude_deg"], 9)]
    return [*degrees, round(place["height_m"], 3)] if place["height_reference"] == "ellipsoid" else degrees
