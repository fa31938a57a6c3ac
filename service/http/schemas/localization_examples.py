"""A query and its answer as the API's description shows them."""

from typing import Any

OPTIONS_EXAMPLE = {
    "frame": "ros",
    "hints": {"position_m": [2.0, 1.0, 1.5], "radius_m": 5, "upright": True, "heading_deg": 90},
    "artifacts": ["score_map_2d", "score_map_3d", "overlay"],
    "timeout_s": 30,
}
_POSE_EXAMPLE: dict[str, Any] = {
    "frame": "ros",
    "map_from_camera": {
        "position_m": {"x": 1.2, "y": 0.3, "z": 1.5},
        "quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        "matrix": [[1.0, 0.0, 0.0, 1.2], [0.0, 1.0, 0.0, 0.3], [0.0, 0.0, 1.0, 1.5], [0.0, 0.0, 0.0, 1.0]],
    },
    "yaw_deg": 0.0,
    "pitch_deg": 0.0,
    "roll_deg": 0.0,
    "heading_deg": 90.0,
    "elevation_deg": 0.0,
    "camera_roll_deg": 0.0,
    "north": "map",
}
_FURTHER_POSE_EXAMPLE = {
    "frame": "ros",
    "map_from_camera": {
        "position_m": {"x": 1.2, "y": 0.4, "z": 1.5},
        "quaternion": {"x": 0.0, "y": 0.0, "z": 0.5, "w": 0.8660254},
        "matrix": [[0.5, -0.8660254, 0.0, 1.2], [0.8660254, 0.5, 0.0, 0.4], [0.0, 0.0, 1.0, 1.5], [0.0, 0.0, 0.0, 1.0]],
    },
    "yaw_deg": 60.0,
    "pitch_deg": 0.0,
    "roll_deg": 0.0,
    "heading_deg": 30.0,
    "elevation_deg": 0.0,
    "camera_roll_deg": 0.0,
    "north": "map",
}
_FRAME_CAMERA_EXAMPLE = {
    "model": "pinhole",
    "width_px": 1920,
    "height_px": 1440,
    "fx_px": 1450.2,
    "fy_px": 1450.2,
    "cx_px": 960,
    "cy_px": 720,
}
SESSION_EXAMPLE = {
    "frame": "ros",
    "cameras": [
        {
            **_FRAME_CAMERA_EXAMPLE,
            "session_from_camera": {
                "position_m": {"x": 0.0, "y": 0.0, "z": 0.0},
                "quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
        },
        {
            **_FRAME_CAMERA_EXAMPLE,
            "session_from_camera": {
                "position_m": {"x": 0.0, "y": 0.1, "z": 0.0},
                "quaternion": {"x": 0.0, "y": 0.0, "z": 0.5, "w": 0.8660254},
            },
        },
    ],
    "session": {"up": "known", "position_noise_m": 0.01, "orientation_noise_deg": 0.5},
}
LOCALIZATION_EXAMPLE = {
    "id": "loc_5m2k8w0x7r4t9c1e",
    "status": "localized",
    "map_id": "map_2xk7q0v9m3d1c8fa",
    "map_revision": 1,
    "pose": _POSE_EXAMPLE,
    "map_from_session": _POSE_EXAMPLE["map_from_camera"],
    "images": [
        {"pose": _POSE_EXAMPLE, "agreement": 0.71, "camera": {"model": "pinhole", "hfov_deg": 67.0}},
        {"pose": _FURTHER_POSE_EXAMPLE, "agreement": 0.64, "camera": {"model": "pinhole", "hfov_deg": 67.0}},
    ],
    "geopose": None,
    "confidence": 0.93,
    "accuracy": {"position_m": 0.02, "orientation_deg": 0.3, "level": 0.68},
    "alternatives": [],
    "change": {"panorama_changed_fraction": 0.18, "map_changed_fraction": 0.11},
    "artifacts": {"overlay": "/localizations/loc_5m2k8w0x7r4t9c1e/overlay.png"},
    "timings_s": {"queue": 0.002, "decode": 0.03, "search": 0.06, "refine": 0.4, "total": 0.51},
    "search": {"num_starts": 412, "num_rotations": 2304, "color_model": "equalized", "sampling_loss": 0.11},
    "warnings": [],
}
PENDING_EXAMPLE = {
    "id": "loc_5m2k8w0x7r4t9c1e",
    "status": "running",
    "created_at": "2026-11-21T12:00:00.000000Z",
    "error": None,
}
