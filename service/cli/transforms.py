"""Reads frames with poses from a `transforms.json`, the format of nerfstudio, instant-ngp and many capture apps.

`transform_matrix` is camera-to-world in metres times `applied_scale`, camera axes of OpenGL (x right, y up, z backward), world z up.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panoloc.core.image.image_header import KIND_BYTES, KNOWN_FORMATS, image_kind
from panoloc.core.options import Frame
from panoloc.service.client import JsonObject

FILE_NAME = "transforms.json"

_MODELS = {
    "OPENCV": "opencv",
    "PINHOLE": "pinhole",
    "OPENCV_FISHEYE": "opencv_fisheye",
    "EQUIRECTANGULAR": "equirectangular",
}
_COEFFICIENTS = {"opencv": ("k1", "k2", "p1", "p2", "k3"), "opencv_fisheye": ("k1", "k2", "k3", "k4")}
_ALL_COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2")
_OPENGL_FROM_FLU = [[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]
_ORTHONORMAL_TOLERANCE = 0.01


class TransformsError(ValueError):
    """The file lacks something; the message says what, where and what to do."""


@dataclass(frozen=True)
class TrackedImage:
    """A frame of the file. camera: its entry in `cameras` of the HTTP API."""

    path: Path
    camera: JsonObject


def read_transforms(path: Path, frame: Frame) -> list[TrackedImage]:
    """Read a `transforms.json`, or the one in a folder, with poses in the axes of `frame`. Raises TransformsError."""
    file = path / FILE_NAME if path.is_dir() else path
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise TransformsError(f"expected a {FILE_NAME} in nerfstudio's format, but {file}: {why}") from error
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(each, dict) for each in frames):
        raise TransformsError(f"expected `frames` with one object per image in {file}, got {str(frames)[:40]}")
    return [_tracked(document | each, file, number, frame) for number, each in enumerate(frames)]


def spread_evenly(images: Sequence[TrackedImage], most: int) -> list[TrackedImage]:
    """Return at most `most` of the images, the first and the last among them."""
    if len(images) <= most:
        return list(images)
    return [images[round(number * (len(images) - 1) / (most - 1))] for number in range(most)]


def _tracked(given: Mapping[str, Any], file: Path, number: int, frame: Frame) -> TrackedImage:
    try:
        pose = _pose(given.get("transform_matrix"), _applied_scale(given), frame)
        return TrackedImage(_image_file(given, file), {**_camera(given), "session_from_camera": pose})
    except TransformsError as error:
        raise TransformsError(f"frames[{number}] of {file}: {error}") from error


def _image_file(given: Mapping[str, Any], file: Path) -> Path:
    """Return the path of an image. A file from elsewhere may name any file on this machine, and what it names is sent."""
    name = given.get("file_path")
    if not isinstance(name, str):
        raise TransformsError(f"file_path: expected the name of an image, got {name!r}")
    # Some writers leave the ending out.
    candidates = [file.parent / f"{name}{ending}" for ending in ("", ".png", ".jpg")]
    path = next((each for each in candidates if each.is_file()), None)
    if path is None:
        raise TransformsError(
            f"file_path: expected an image beside the file, but there is no {candidates[0]}; put the file into the folder of "
            "its images"
        )
    try:
        with path.open("rb") as stream:
            head = stream.read(KIND_BYTES)
    except OSError as error:
        raise TransformsError(f"file_path: expected an image that can be read, but {path}: {error.strerror}") from error
    if image_kind(head) is None:
        raise TransformsError(
            f"file_path: expected a {KNOWN_FORMATS} image, got {path}, whose first bytes match none of these. "
            "Convert it, or remove the frame. Nothing was sent"
        )
    return path


def _camera(given: Mapping[str, Any]) -> JsonObject:
    """Return the camera without its pose."""
    lens = {name: _number(given, name, 0.0) for name in _ALL_COEFFICIENTS}
    model = _model(given, lens)
    if model == "equirectangular":
        return {"model": model}
    taken = _COEFFICIENTS.get(model, ())
    foreign = [name for name in _ALL_COEFFICIENTS if name not in taken and lens[name] != 0]
    if foreign:
        raise TransformsError(
            f"{foreign[0]}: expected coefficients of {model} ({' '.join(taken) or 'none'}), "
            f"got {lens[foreign[0]]:g}; undistort the images"
        )
    camera: JsonObject = {"model": model, **({"distortion": [lens[name] for name in taken]} if taken else {})}
    if given.get("fl_x") is None and given.get("camera_angle_x") is not None:
        return camera | {"hfov_deg": math.degrees(_number(given, "camera_angle_x"))}
    width, height, fx = (_number(given, name) for name in ("w", "h", "fl_x"))
    return camera | {
        "width_px": int(width),
        "height_px": int(height),
        "fx_px": fx,
        "fy_px": _number(given, "fl_y", fx),
        "cx_px": _number(given, "cx", width / 2),
        "cy_px": _number(given, "cy", height / 2),
    }


def _model(given: Mapping[str, Any], lens: Mapping[str, float]) -> str:
    name = given.get("camera_model")
    if name is None:
        return "opencv_fisheye" if given.get("is_fisheye") else "opencv" if any(lens.values()) else "pinhole"
    if name not in _MODELS:
        raise TransformsError(f"camera_model: expected one of {', '.join(_MODELS)}, got {name!r}; undistort the images")
    return _MODELS[name]


def _number(given: Mapping[str, Any], name: str, default: float | None = None) -> float:
    value = given.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TransformsError(f"{name}: expected a number, got {value!r}")
    return float(value)


def _applied_scale(given: Mapping[str, Any]) -> float:
    """Return by how much the tool that wrote the file has scaled the positions."""
    scale = given.get("applied_scale", 1.0)
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale < math.inf:
        raise TransformsError(f"applied_scale: expected a positive number, got {str(scale)[:40]}")
    return float(scale)


def _pose(given: Any, scale: float, frame: Frame) -> JsonObject:
    """Return position (metres) and quaternion in the axes of `frame`, as the HTTP API takes them. scale: of the positions given."""
    # Commands load numpy only when they need it.
    import numpy as np

    from panoloc.core.geometry.pose import Pose

    try:
        matrix = np.asarray(given, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise TransformsError(f"transform_matrix: expected 4 x 4 numbers, row by row, got {str(given)[:60]}")
    rotation, position = matrix[:3, :3], matrix[:3, 3] / scale
    if not np.isfinite(matrix).all():
        raise TransformsError("transform_matrix: expected finite numbers, got NaN or infinity; was the frame tracked?")
    off = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if off > _ORTHONORMAL_TOLERANCE or np.linalg.det(rotation) <= 0:
        raise TransformsError(
            "transform_matrix: expected a rotation and a position in metres, "
            "got a matrix that also scales or mirrors; remove the scale"
        )
    pose = Pose(rotation @ np.array(_OPENGL_FROM_FLU), position).in_frame(frame)
    return {
        "position_m": dict(zip("xyz", pose.position.tolist(), strict=True)),
        "quaternion": dict(zip("xyzw", pose.quaternion_xyzw.tolist(), strict=True)),
    }
