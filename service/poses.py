"""Poses as answers have them: with the angles of photographers, and on Earth. Needs numpy, but no torch."""

import math
from collections.abc import Mapping
from typing import Any

from panoloc.core.earth.geopose import geopose_of
from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Frame
from panoloc.service.answer import GeoPose, PoseAnswer, Position, Quaternion, RigidMotion

PlaceOnEarth = Mapping[str, Any]
"""As `panoloc.core.earth.geopose.geopose_of` takes it."""


def pose_answer(pose: Pose, frame: Frame, place: PlaceOnEarth | None) -> PoseAnswer:
    """Return a pose with rotations about its axes, and the same angles in photographers' terms. place: of the map, if it is known."""
    yaw_deg, pitch_deg, roll_deg = (math.degrees(angle) for angle in pose.yaw_pitch_roll)
    north_deg = _north_deg(pose, place)
    return PoseAnswer(
        frame=frame,
        map_from_camera=motion(pose.in_frame(frame)),
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        roll_deg=roll_deg,
        heading_deg=round((90.0 - yaw_deg + (north_deg or 0.0)) % 360.0, 9) % 360.0,
        elevation_deg=0.0 - pitch_deg,
        camera_roll_deg=roll_deg,
        north="map" if north_deg is None else "true",
    )


def motion(pose: Pose) -> RigidMotion:
    """Return a pose in the axes that it has."""
    position, quaternion = pose.position.tolist(), pose.quaternion_xyzw.tolist()
    return RigidMotion(
        position_m=Position(**dict(zip("xyz", position, strict=True))),
        quaternion=Quaternion(**dict(zip("xyzw", quaternion, strict=True))),
        matrix=pose.matrix.tolist(),
    )


def geopose(pose: Pose, place: PlaceOnEarth | None) -> GeoPose | None:
    """Return the GeoPose of a pose; None where the map's place, or its height above the ellipsoid, is unknown."""
    found = None if place is None else geopose_of(place, pose)
    return None if found is None else GeoPose.model_validate(found)


def _north_deg(pose: Pose, place: PlaceOnEarth | None) -> float | None:
    """Return the heading of the map's y axis at a pose, clockwise from true north; None where it is unknown."""
    if place is None:
        return None
    if "coordinate_system" not in place:
        return float(place["heading_deg"])
    x, y, z = pose.position.tolist()
    found = coordinate_system(place["coordinate_system"]).place((x, y, z))
    return None if found is None else found.convergence_deg
