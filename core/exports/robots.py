"""Formats of robotics: messages of ROS 2, and trajectories as TUM evaluates them."""

import json
import math
from collections.abc import Iterator
from typing import Any

from panoloc.core.earth.geopose import EarthPose
from panoloc.core.exports.earth import on_earth
from panoloc.core.exports.tour import TIME_DECIMALS, ExportedFile, PlacedPhoto, Tour, json_file, plain, text_file
from panoloc.core.geometry.pose import quaternion_of

FRAME_ID = "map"
RADIUS_PER_SIGMA = 1.872
"""Of a sphere that holds 68 % of a normal distribution in three dimensions (χ² with three degrees of freedom)."""


def write_ros(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `poses.json` and `poses.yaml` (for `ros2 topic pub`), `geometry_msgs/PoseWithCovarianceStamped` per photo.

    With a place on Earth also `geo_poses.json`, of `geographic_msgs/GeoPoseWithCovariance`; its altitude counts from the ellipsoid,
    and is null where that is not known. The body frame is x forward,
    y left, z up (REP-103), not an `_optical` one. Covariances are about the map's fixed axes, in m² and rad²; zeros where
    the accuracy is not known, as ROS has it.
    """
    messages = [_stamped(photo, time) for photo, time in zip(tour.photos, tour.times_unix_s, strict=True)]
    named = [{"image": photo.name, "message": each} for photo, each in zip(tour.photos, messages, strict=True)]
    yield json_file("poses.json", named)
    # JSON is YAML too, one document per message.
    documents = (f"# {item['image']}\n{json.dumps(item['message'])}\n" for item in named)
    yield ExportedFile("poses.yaml", "---\n".join(documents).encode())
    if tour.georeference is not None or tour.coordinate_system is not None:
        yield json_file("geo_poses.json", [_on_earth(photo, place) for photo, place, _ in on_earth(tour)])


def write_tum(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `poses.tum`: map from body, seconds and metres, quaternion with w last; and the photo of each line."""
    lines = ["# timestamp tx ty tz qx qy qz qw: map from body, body axes x forward, y left, z up"]
    names = []
    for photo, time_unix_s in zip(tour.photos, tour.times_unix_s, strict=True):
        pose = photo.map_from_camera
        time = plain(time_unix_s, TIME_DECIMALS)
        lines.append(" ".join([time, *(plain(value, 12) for value in (*pose.position, *pose.quaternion_xyzw))]))
        names.append(f"{time} {photo.name}")
    yield text_file("poses.tum", lines)
    yield text_file("names.txt", names)


def _stamped(photo: PlacedPhoto, time_unix_s: float) -> dict[str, Any]:
    pose = photo.map_from_camera
    nanoseconds = round(time_unix_s * 1e6) * 1000  # a float holds no more than microseconds of this century
    return {
        "header": {
            "stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
            "frame_id": FRAME_ID,
        },
        "pose": {
            "pose": {
                "position": dict(zip("xyz", pose.position.tolist(), strict=True)),
                "orientation": dict(zip("xyzw", pose.quaternion_xyzw.tolist(), strict=True)),
            },
            "covariance": _covariance(photo),
        },
    }


def _on_earth(photo: PlacedPhoto, found: EarthPose) -> dict[str, Any]:
    altitude = found.height_m if found.height_reference == "ellipsoid" else None
    place = {"latitude": found.latitude_deg, "longitude": found.longitude_deg, "altitude": altitude}
    orientation = dict(zip("xyzw", quaternion_of(found.enu_from_camera).tolist(), strict=True))
    message = {"pose": {"position": place, "orientation": orientation}, "covariance": _covariance(photo)}
    return {"image": photo.name, "message": message}


def _covariance(photo: PlacedPhoto) -> list[float]:
    """Return 36 numbers, row by row, over x, y, z and rotations about them; equal on all axes, so that axes can be turned."""
    variances = [0.0, 0.0]
    if photo.position_radius_m is not None and photo.orientation_radius_deg is not None:
        sigmas = photo.position_radius_m, math.radians(photo.orientation_radius_deg)
        variances = [(radius / RADIUS_PER_SIGMA) ** 2 for radius in sigmas]
    return [variances[row // 3] if row == column else 0.0 for row in range(6) for column in range(6)]
