"""Requests and responses as the API's description shows them."""

from typing import Any

_MAP_ID, _QUERY_ID = "map_2xk7q0v9m3d1c8fa", "loc_5m2k8w0x7r4t9c1e"
_CREATED_AT = "2026-11-21T12:00:00.000000Z"


def _motion(x: float, y: float, z: float) -> dict[str, Any]:
    return {"position_m": {"x": x, "y": y, "z": z}, "quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _pose(y: float) -> dict[str, Any]:
    matrix = [[1.0, 0.0, 0.0, 1.2], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, 1.5], [0.0, 0.0, 0.0, 1.0]]
    angles = dict.fromkeys(("yaw_deg", "pitch_deg", "roll_deg", "elevation_deg", "camera_roll_deg"), 0.0)
    motion = {**_motion(1.2, y, 1.5), "matrix": matrix}
    return {"frame": "ros", "map_from_camera": motion, **angles, "heading_deg": 90.0, "north": "map"}


def _frame_camera(y: float) -> dict[str, Any]:
    intrinsics = {"width_px": 1920, "height_px": 1440, "fx_px": 1450.2, "fy_px": 1450.2, "cx_px": 960, "cy_px": 720}
    return {"model": "pinhole", **intrinsics, "session_from_camera": _motion(0.0, y, 0.0)}


OPTIONS_EXAMPLE = {
    "frame": "ros",
    "hints": {"position_m": [2.0, 1.0, 1.5], "radius_m": 5, "upright": True, "heading_deg": 90},
    "artifacts": ["score_map_2d", "score_map_3d", "overlay"],
    "timeout_s": 30,
}
SESSION_EXAMPLE = {
    "frame": "ros",
    "cameras": [_frame_camera(0.0), _frame_camera(0.1)],
    "session": {"up": "known", "position_noise_m": 0.01, "orientation_noise_deg": 0.5},
}
_FRAME_CAMERA = {"model": "pinhole", "hfov_deg": 67.0}
LOCALIZATION_EXAMPLE = {
    "id": _QUERY_ID,
    "status": "localized",
    "placed_by": "engine",
    "map_id": _MAP_ID,
    "map_revision": 1,
    "pose": _pose(0.3),
    "map_from_session": _pose(0.3)["map_from_camera"],
    "images": [
        {"pose": _pose(0.3), "agreement": 0.71, "camera": _FRAME_CAMERA},
        {"pose": _pose(0.4), "agreement": 0.64, "camera": _FRAME_CAMERA},
    ],
    "geopose": None,
    "confidence": 0.93,
    "accuracy": {"position_m": 0.02, "orientation_deg": 0.3, "level": 0.68},
    "alternatives": [],
    "change": {"panorama_changed_fraction": 0.18, "map_changed_fraction": 0.11},
    "artifacts": {"overlay": f"/localizations/{_QUERY_ID}/overlay.png"},
    "timings_s": {"queue": 0.002, "decode": 0.03, "search": 0.06, "refine": 0.4, "total": 0.51},
    "search": {"num_starts": 412, "num_rotations": 2304, "color_model": "equalized", "sampling_loss": 0.11},
    "warnings": [],
    "reasons": [],
}
COORDINATES_EXAMPLE = {
    "position_m": [691520.0, 5334740.0, 521.3],
    "grid": {
        "coordinate_system": "EPSG:25832",
        "name": "ETRS89 / UTM zone 32N",
        "east": 691520.0,
        "north": 5334740.0,
        "unit": "m",
        "height_m": 521.3,
    },
    "wgs84": {"latitude_deg": 48.138, "longitude_deg": 11.574, "height_m": 521.3, "height_reference": "unknown"},
}
PENDING_EXAMPLE = {"id": _QUERY_ID, "status": "running", "created_at": _CREATED_AT, "error": None}
MAP_OPTIONS_EXAMPLE = {
    "name": "3rd floor",
    "tags": ["building 7"],
    "unit": "mm",
    "starts": {"method": "octree", "region": {"min": [0, 0, 0.5], "max": [12, 8, 2.2]}},
}
MAP_EXAMPLE = {
    "id": _MAP_ID,
    "name": "3rd floor",
    "tags": ["building 7"],
    "revision": 1,
    "serving_revision": 1,
    "status": "ready",
    "stage": None,
    "progress": 1.0,
    "error": None,
    "created_at": _CREATED_AT,
    "updated_at": "2026-11-21T12:00:02.400000Z",
    "stats": {
        "num_points": 1_000_000,
        "num_points_used": 250_000,
        "bounds": {"min": [0.0, 0.0, 0.0], "max": [12.4, 8.1, 2.6]},
        "origin_offset": [0.0, 0.0, 0.0],
        "num_starts": 412,
        "index_bytes": 1_830_000,
        "seconds": {"read": 0.5, "starts": 0.2, "render": 1.1},
        "coordinate_system": None,
    },
    "diagnostics": [
        {"code": "thinned", "severity": "info", "message": "1,000,000 points were thinned to 250,000."},
    ],
    "georeference": None,
    "coordinate_system": None,
    "geoid_undulation_m": None,
    "owner": None,
    "shared_with": [],
    "version": 3,
}
QUEUED_MAP_EXAMPLE = {
    **MAP_EXAMPLE,
    "serving_revision": None,
    "status": "queued",
    "progress": 0.0,
    "stats": None,
    "diagnostics": [],
}
LINK_EXAMPLE = {
    "url": f"https://scanner.local:8000/m/{_MAP_ID}#key=pk_8sCk3…",
    "key_id": "key_5d41402a",
    "qr_svg": '<svg viewBox="0 0 41 41">…</svg>',
}
CHANGES_EXAMPLE: dict[str, Any] = {
    "map_id": _MAP_ID,
    "revision": 1,
    "lifetime_s": 2_592_000,
    "cell_m": 0.15,
    "answers": [
        {
            "id": "loc_9b1f0c6a7d2e4f35",
            "created_at": "2026-11-21T12:00:00Z",
            "position_m": [1.2, 0.3, 1.5],
            "confidence": 0.93,
            "panorama_changed_fraction": 0.18,
            "map_changed_fraction": 0.11,
        }
    ],
    "num_photos": 3,
    "objects": [
        {
            "id": "5f0c2a9b7e31",
            "kind": "moved",
            "center_m": [2.03, 0.98, 0.44],
            "size_m": [0.52, 0.55, 0.88],
            "from_m": [0.61, 1.2, 0.44],
            "floor": 0,
            "certainty": 0.91,
            "is_sure": True,
            "num_photos": 3,
            "seen_from_m": [1.2, 0.3, 1.5],
            "first_seen_at": "2026-11-21T12:00:00Z",
            "last_seen_at": "2026-11-21T12:04:00Z",
        }
    ],
    "cells": [
        {"center_m": [2.025, 0.975, 0.375], "num_changed": 1, "num_seen": 1, "last_changed_at": "2026-11-21T12:00:00Z"}
    ],
}
BATCH_OVERVIEW_EXAMPLE: dict[str, Any] = {
    "id": "batch_7c1d9e2f4a6b8035",
    "name": "ground floor",
    "status": "queued",
    "created_at": _CREATED_AT,
    "map_ids": [_MAP_ID],
    "tag": None,
    "num_images": 2,
    "progress": 0.0,
}
BATCH_PAGE_EXAMPLE = {"items": [BATCH_OVERVIEW_EXAMPLE], "next_cursor": None}
QUEUED_BATCH_EXAMPLE = {
    **BATCH_OVERVIEW_EXAMPLE,
    "counts": {"waiting": 2, "localized": 0, "ambiguous": 0, "not_localized": 0, "failed": 0},
    "ignored": ["notes.txt"],
    "items": [],
    "next_cursor": None,
}
BATCH_EXAMPLE = {
    **QUEUED_BATCH_EXAMPLE,
    "status": "running",
    "progress": 0.5,
    "counts": {"waiting": 1, "localized": 1, "ambiguous": 0, "not_localized": 0, "failed": 0},
    "items": [
        {"number": 0, "name": "hall.jpg", "status": "localized", "answer": LOCALIZATION_EXAMPLE, "error": None},
        {"number": 1, "name": "stairs.jpg", "status": "waiting", "answer": None, "error": None},
    ],
}
GEOPOSE_REQUEST_EXAMPLE = {
    "id": "3a6a9c1e-6bf0-4d43-9b0f-1c4b3a0d7f52",
    "timestamp": 1750939398316,
    "type": "geopose",
    "sensors": [{"id": "camera", "type": "camera"}],
    "sensorReadings": {
        "cameraReadings": [{"sensorId": "camera", "size": [2048, 1024], "imageBytes": "(base64)"}],
        "geolocationReadings": [{"latitude": 47.7, "longitude": -122.3, "accuracy": 20}],
    },
}

_PLACED = {
    "pose": _pose(0.3),
    "camera": {"model": "equirectangular", "hfov_deg": 360.0},
    "residuals_px": [1.2, 2.4, 0.8, 2.1],
    "rms_px": 1.75,
    "agreement": None,
    "confidence": 0.97,
    "accuracy": {"position_m": 0.06, "orientation_deg": 0.9, "level": 0.68},
    "warnings": [],
}
HAND_POSE_EXAMPLE = {
    "pairs": [
        {"pixel": [410.5, 288.0], "position_m": [0.0, 4.1, 2.5]},
        {"pixel": [1211.0, 302.5], "position_m": [6.0, 4.1, 2.4]},
        {"pixel": [1650.0, 640.0], "position_m": [5.2, 0.0, 0.8]},
        {"pixel": [90.0, 655.5], "position_m": [0.4, 0.0, 0.7]},
    ],
    "confirm": True,
}
HAND_PLACEMENT_EXAMPLE: dict[str, Any] = {
    "given": _PLACED,
    "refined": {**_PLACED, "rms_px": 2.02, "residuals_px": [1.9, 2.6, 1.1, 2.2], "agreement": 0.66},
    "better": "refined",
    "moved_m": 0.04,
    "moved_deg": 0.6,
    "item": {
        "number": 3,
        "name": "hall/4.jpg",
        "status": "localized",
        "answer": {
            **LOCALIZATION_EXAMPLE,
            "placed_by": "hand",
            "warnings": ["a person has placed this photo"],
            "reasons": ["placed_by_hand"],
        },
        "error": None,
    },
}
