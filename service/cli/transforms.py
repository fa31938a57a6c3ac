"""Frames with their poses as `transforms.json` has them: the format of nerfstudio and instant-ngp, which many capture apps write.

`transform_matrix` is camera-to-world, metres, camera axes of OpenGL (x right, y up, z backward), world z up.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from core.options import Frame
from core.panorama.image_header import KIND_BYTES, KNOWN_FORMATS, image_kind
from service.client import JsonObject

FILE_NAME = "transforms.json"

Matrix = list[list[float]]

_MODELS = {
    "OPENCV": "opencv",
    "PINHOLE": "pinhole",
    "OPENCV_FISHEYE": "opencv_fisheye",
    "EQUIRECTANGULAR": "equirectangular",
}
_COEFFICIENTS = {"opencv": ("k1", "k2", "p1", "p2", "k3"), "opencv_fisheye": ("k1", "k2", "k3", "k4")}
_ALL_COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2")
# Rows are the axes of each frame: of its camera in OpenGL's, of its world in one with z up.
_SAME = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
_CAMERA_FROM_GL: dict[Frame, Matrix] = {
    "ros": [[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    "opencv": [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
    "webxr": _SAME,
    "unity": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
}
_WORLD_FROM_Z_UP: dict[Frame, Matrix] = {
    "ros": _SAME,
    "opencv": _SAME,
    "webxr": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
    "unity": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
}
_ORTHONORMAL_TOLERANCE = 0.01


class TransformsError(ValueError):
    """The file does not say what is needed; the message says what, where and what to do."""


@dataclass(frozen=True)
class TrackedImage:
    """A frame of the file. camera: its entry of `cameras` as the HTTP API takes it."""

    path: Path
    camera: JsonObject


def read_transforms(path: Path, frame: Frame) -> list[TrackedImage]:
    """Read the frames of a `transforms.json`, or of the folder that holds one, poses in the axes of `frame`. Raises TransformsError."""
    file = path / FILE_NAME if path.is_dir() else path
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise TransformsError(f"expected a {FILE_NAME} as nerfstudio has it, but {file}: {error}") from error
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
        position, quaternion = _pose(given.get("transform_matrix"), frame)
        pose = {
            "position_m": dict(zip("xyz", position, strict=True)),
            "quaternion": dict(zip("xyzw", quaternion, strict=True)),
        }
        return TrackedImage(_image_file(given, file), {**_camera(given), "session_from_camera": pose})
    except TransformsError as error:
        raise TransformsError(f"frames[{number}] of {file}: {error}") from error


def _image_file(given: Mapping[str, Any], file: Path) -> Path:
    name = given.get("file_path")
    if not isinstance(name, str):
        raise TransformsError(f"file_path: expected the name of an image, got {name!r}")
    # Some writers leave the ending out.
    for candidate in (name, f"{name}.png", f"{name}.jpg"):
        if (file.parent / candidate).is_file():
            return _checked_image(file.parent / candidate)
    raise TransformsError(f"file_path: expected an image beside the file, but there is no {file.parent / name}")


def _checked_image(path: Path) -> Path:
    """Return the path of an image. Files of others may name anything on this machine, and what they name leaves it."""
    try:
        with path.open("rb") as stream:
            head = stream.read(KIND_BYTES)
    except OSError as error:
        raise TransformsError(f"file_path: expected an image that can be read, but {path}: {error.strerror}") from error
    if image_kind(head) is None:
        raise TransformsError(
            f"file_path: expected a {KNOWN_FORMATS} image, got {path}, which is none by its first bytes; convert it, or take the frame "
            "out. Nothing was sent"
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
            f"{foreign[0]}: expected coefficients of {model} ({' '.join(taken) or 'none'}), got {lens[foreign[0]]:g}; undistort the images"
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


def _pose(given: Any, frame: Frame) -> tuple[list[float], list[float]]:
    """Return position (metres) and quaternion (x, y, z, w) in the axes of `frame`."""
    try:
        rows = [[float(value) for value in row] for row in given[:3]]
        rotation, position = [row[:3] for row in rows], [[row[3]] for row in rows]
    except (TypeError, ValueError, IndexError) as error:
        raise TransformsError(f"transform_matrix: expected 4 x 4 numbers, row by row, got {str(given)[:60]}") from error
    _check_rotation(rotation)
    world, camera = _WORLD_FROM_Z_UP[frame], _CAMERA_FROM_GL[frame]
    turned = _product(_product(world, rotation), _transposed(camera))
    return [row[0] for row in _product(world, position)], _quaternion(turned)


def _check_rotation(rotation: Matrix) -> None:
    if not all(math.isfinite(value) for row in rotation for value in row):
        raise TransformsError("transform_matrix: expected finite numbers, got NaN or infinity; was the frame tracked?")
    square = _product(_transposed(rotation), rotation)
    off = max(abs(square[row][column] - _SAME[row][column]) for row in range(3) for column in range(3))
    (a, b, c), (d, e, f), (g, h, i) = rotation
    if not off <= _ORTHONORMAL_TOLERANCE or a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) <= 0:
        raise TransformsError(
            "transform_matrix: expected a rotation and a position in metres, got a matrix that also scales or mirrors; take the scale out"
        )


def _quaternion(r: Matrix) -> list[float]:
    """Return the unit quaternion (x, y, z, w), by the largest of its components (Shepperd 1978)."""
    trace = r[0][0] + r[1][1] + r[2][2]
    squares = [1 - trace + 2 * r[axis][axis] for axis in range(3)] + [1 + trace]
    i = max(range(4), key=lambda axis: squares[axis])
    if i == 3:
        found = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1], squares[3]]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        found = [0.0, 0.0, 0.0, r[k][j] - r[j][k]]
        found[i], found[j], found[k] = squares[i], r[i][j] + r[j][i], r[i][k] + r[k][i]
    norm = math.hypot(*found)
    return [value / norm for value in found]


def _product(first: Matrix, second: Matrix) -> Matrix:
    columns = _transposed(second)
    return [[sum(a * b for a, b in zip(row, column, strict=True)) for column in columns] for row in first]


def _transposed(matrix: Matrix) -> Matrix:
    return [list(column) for column in zip(*matrix, strict=True)]
