"""Map indexes as bytes: a header, then little-endian arrays, compressed. No pickle: reading runs no code.

Layout: magic `PLMI`, version (uint16), length of a JSON header (uint32), the header, the arrays. Positions are 16-bit steps of the bounds
up to 100 m (at most 1.5 mm), 32-bit steps beyond, descriptors bytes scaled per view (the rounding moves no score by more than 0.5 %).
"""

import json
import struct
import zlib
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from core.color_equalization import LabelCodes
from core.errors import IndexFormatError
from core.map_index import MapIndex
from core.patch_descriptors import ViewDescriptors

_MAGIC = b"PLMI"
_VERSION = 1
_SHORT_EXTENT_M = 100.0
_LONG_STEP_M = 0.0005
_PREFIX = struct.Struct("<4sHI")


def encode_map_index(index: MapIndex) -> bytes:
    """Return the index as bytes, about 3 to 8 MB for a room."""
    lower, step, positions = _quantize_positions(index.positions)
    scale = index.descriptors.values.abs().amax((1, 2)).clamp_min(1e-9) / 127
    values = (index.descriptors.values / scale[:, None, None]).round().to(torch.int8)
    arrays = {
        "positions": positions,
        "colors": _array(index.colors),
        "starts": _array(index.starts),
        "leaf_sizes": _array(index.leaf_sizes),
        "descriptors": _array(values),
        "descriptor_scale": _array(scale),
        "basis": _array(index.descriptors.basis),
        "patch_weights": _array(index.descriptors.weights.half()),
        "start_points": _array(index.start_points),
        "start_colors": _array(index.start_colors),
        "start_colors_coarse": _array(index.start_colors_coarse),
    }
    if index.labels is not None:
        arrays |= {"labels": _array(index.labels.labels.int()), "label_codes": _array(index.labels.codes)}
    header = {
        "lower": lower.tolist(),
        "step": step,
        "origin_offset": index.origin_offset.tolist(),
        "spacing": index.spacing,
        "num_points_read": index.num_points_read,
        "num_rotations": index.num_rotations,
        "arrays": [{"name": k, "dtype": v.dtype.str, "shape": v.shape} for k, v in arrays.items()],
    }
    text = json.dumps(header).encode()
    body = zlib.compress(b"".join(v.tobytes() for v in arrays.values()), level=1)
    return _PREFIX.pack(_MAGIC, _VERSION, len(text)) + text + body


def decode_map_index(data: bytes, device: torch.device | str = "cpu") -> MapIndex:
    """Return the index of bytes made by `encode_map_index`. Raises IndexFormatError for anything else."""
    header, arrays = _read(data)
    try:
        index = _assemble(header, arrays)
        _check_fit(index)
        return index.to(device)
    except (KeyError, ValueError, TypeError, RuntimeError, OverflowError, AttributeError, IndexError) as error:
        raise IndexFormatError(
            f"map index: its arrays do not fit together ({error}); build it again from the scan"
        ) from error


def _read(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[np.generic]]]:
    if len(data) < _PREFIX.size:
        raise IndexFormatError(
            f"map index: expected at least {_PREFIX.size} bytes, got {len(data)}; build it again from the scan"
        )
    magic, version, length = _PREFIX.unpack_from(data)
    if magic != _MAGIC or version != _VERSION:
        raise IndexFormatError(
            f"map index: expected version {_VERSION}, got {magic!r} {version}; build it again from the scan"
        )
    try:
        header = json.loads(data[_PREFIX.size : _PREFIX.size + length])
        body = zlib.decompress(data[_PREFIX.size + length :])
        arrays, offset = {}, 0
        for entry in header["arrays"]:
            dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
            count = int(np.prod(shape, dtype=np.int64))
            arrays[entry["name"]] = np.frombuffer(body, dtype, count, offset).reshape(shape)
            offset += count * dtype.itemsize
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError, SyntaxError, zlib.error) as error:
        raise IndexFormatError(f"map index: the bytes are damaged ({error}); build it again from the scan") from error
    return header, arrays


def _assemble(header: dict[str, Any], arrays: dict[str, NDArray[np.generic]]) -> MapIndex:
    tensors = {name: torch.from_numpy(array.copy()) for name, array in arrays.items() if name != "positions"}
    steps = np.asarray(arrays["positions"], np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # a damaged header; `_check_fit` refuses what comes of it
        positions = torch.from_numpy(steps * float(header["step"]) + np.asarray(header["lower"], np.float32))
    values = tensors["descriptors"].float() * tensors["descriptor_scale"][:, None, None]
    labels = LabelCodes(tensors["labels"], tensors["label_codes"]) if "labels" in tensors else None
    return MapIndex(
        positions=positions,
        colors=tensors["colors"],
        origin_offset=np.asarray(header["origin_offset"], np.float64),
        spacing=float(header["spacing"]),
        starts=tensors["starts"],
        leaf_sizes=tensors["leaf_sizes"],
        descriptors=ViewDescriptors(values, tensors["basis"], tensors["patch_weights"].float()),
        start_points=tensors["start_points"],
        start_colors=tensors["start_colors"],
        start_colors_coarse=tensors["start_colors_coarse"],
        labels=labels,
        num_points_read=int(header["num_points_read"]),
        num_rotations=int(header["num_rotations"]),
    )


def _check_fit(index: MapIndex) -> None:
    """Raise ValueError when the arrays do not describe the same points, starts and patches."""
    views = index.descriptors
    num_patches, size = views.values.shape[1:]
    points, starts, seen = index.num_points, index.num_starts, index.start_points.shape[1]
    expected: dict[str, tuple[Any, tuple[int, ...]]] = {
        "positions": (index.positions, (points, 3)),
        "colors": (index.colors, (points, 3)),
        "starts": (index.starts, (starts, 3)),
        "leaf_sizes": (index.leaf_sizes, (starts,)),
        "descriptors": (views.values, (starts, num_patches, size)),
        "basis": (views.basis, (len(views.basis), size)),
        "patch_weights": (views.weights, (starts, num_patches)),
        "start_points": (index.start_points, (starts, seen)),
        "start_colors": (index.start_colors, (starts, seen, 3)),
        "start_colors_coarse": (index.start_colors_coarse, (starts, seen, 3)),
        "origin_offset": (index.origin_offset, (3,)),
    }
    for name, (array, shape) in expected.items():
        if tuple(array.shape) != shape:
            raise ValueError(f"{name}: expected the shape {shape}, got {tuple(array.shape)}")
    if points == 0 or starts == 0 or not -1 <= int(index.start_points.min()) <= int(index.start_points.max()) < points:
        raise ValueError("start_points: expected numbers of points of this map")


def _quantize_positions(positions: Tensor) -> tuple[NDArray[np.float32], float, NDArray[np.generic]]:
    """Return the lower bound (3,), the step in metres and whole steps (N, 3); one step for all axes keeps angles.

    16 bits up to 100 m, where a step is 1.5 mm; 32 bits beyond.
    """
    points = _array(positions)
    lower = points.min(axis=0)
    extent = float((points.max(axis=0) - lower).max())
    if extent <= _SHORT_EXTENT_M:
        step, dtype = max(extent / 65535, 1e-9), "<u2"
    else:
        step, dtype = _LONG_STEP_M, "<u4"
    return lower, step, np.round((points - lower) / step).astype(dtype)


def _array(tensor: Tensor) -> NDArray[np.generic]:
    return np.ascontiguousarray(tensor.detach().cpu().numpy())
