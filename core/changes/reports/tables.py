"""Changes as CSV, and as GeoJSON (RFC 7946)."""

import csv
import io
import json
from typing import Any

import numpy as np

from panoloc.core.changes.reports.report import ChangeReport
from panoloc.core.earth.geopose import Georeference, earth_pose, grid_pose
from panoloc.core.geometry.pose import Pose

_COLUMNS = (
    "number", "id", "kind", "x_m", "y_m", "z_m", "width_m", "depth_m", "height_m", "from_x_m", "from_y_m", "from_z_m", "floor", "certainty",
    "is_sure", "photos", "first_seen_at", "last_seen_at",
)  # fmt: skip


def as_csv(report: ChangeReport) -> bytes:
    """Return one line per object, in metres of the map's own frame."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(_COLUMNS)
    for number, each in enumerate(report.objects, 1):
        before = each["from_m"] or ("", "", "")
        numbers = (*each["center_m"], *each["size_m"], *before)
        seen = each["num_photos"], each["first_seen_at"], each["last_seen_at"]
        floor = "" if each["floor"] is None else each["floor"]
        writer.writerow(
            (number, each["id"], each["kind"], *numbers, floor, each["certainty"], int(each["is_sure"]), *seen)
        )
    return text.getvalue().encode()


def as_geojson(report: ChangeReport) -> bytes:
    """Return a feature per object: a point in WGS 84 (longitude, latitude, height) where the map's place on Earth is known.

    Elsewhere points are in metres of the map's own frame, which `crs_note` says: no other program takes them for degrees unasked.
    """
    document: dict[str, Any] = {"type": "FeatureCollection", "name": report.title}
    if report.coordinate_system is None and report.georeference is None:
        document["crs_note"] = (
            "Coordinates are metres in the map's own frame, not degrees: where the map is on Earth is unknown."
        )
    document["features"] = [_feature(report, each) for each in report.objects]
    return json.dumps(document, indent=1).encode()


def _feature(report: ChangeReport, each: dict[str, Any]) -> dict[str, Any]:
    point = {"type": "Point", "coordinates": _coordinates(report, each["center_m"])}
    properties = {name: value for name, value in each.items() if name != "id"}
    return {"type": "Feature", "id": each["id"], "geometry": point, "properties": properties}


def _coordinates(report: ChangeReport, position_m: list[float]) -> list[float]:
    """Return longitude, latitude and, where it is known, height above the ellipsoid; without a place on Earth the position itself."""
    pose = Pose(np.eye(3), np.array(position_m))
    if report.coordinate_system is not None:
        found = grid_pose(report.coordinate_system, report.geoid_undulation_m, pose)
    elif report.georeference is not None:
        found = earth_pose(Georeference(**report.georeference), pose)
    else:
        return position_m
    if found is None:
        return position_m
    degrees = [round(found.longitude_deg, 9), round(found.latitude_deg, 9)]
    return [*degrees, round(found.height_m, 3)] if found.height_reference == "ellipsoid" else degrees
