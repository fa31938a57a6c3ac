"""Map indexes as bytes: a header, then little-endian arrays, compressed. No pickle: reading runs no code.

Layout: magic `PLMI`, version (uint16), length of a JSON header (uint32), the header, the arrays. Positions are steps of a sixteenth of the
points' spacing, colours of points 6 bits a channel (labels all 8), descriptors 31 steps up and down per view. docs/experiments.md ("How
small can an index be?") says what is lost by it: nothing that can be measured.
"""

import json
import struct
from typing import Any

import numpy as np
import torch
import zstandard
from numpy.typing import NDArray
from torch import Tensor

from panoloc.core.errors import IndexFormatError
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.map.aliases import Aliases
from panoloc.core.map.map_index import INDEX_VERSION, MapIndex

Bytes = NDArray[np.uint8]
_MAGIC = b"PLMI"
_STEPS_PER_SPACING = 16
_COLOR_LEVELS = 64
_PREFIX = struct.Struct("<4sHI")
_DAMAGE = (
    LookupError,
    ValueError,
    TypeError,
    RuntimeError,
    OverflowError,
    AttributeError,
    SyntaxError,
    zstandard.ZstdError,
)


def encode_map_index(index: MapIndex) -> bytes:
    """Return the index as bytes, 7 MB for a room of 400 starts."""
    points = index.positions.detach().cpu().numpy()
    # One step for all axes keeps angles.
    lower, step = points.min(axis=0), max(index.spacing / _STEPS_PER_SPACING, 1e-9)
    views, levels = index.views, _color_levels(index.labels)
    arrays = {
        "positions": pack_steps(np.round((points - lower) / step).astype(np.int64)),
        "colors": pack_colors(_array(index.colors), levels),
        "starts": _array(index.starts),
        "leaf_sizes": _array(index.leaf_sizes),
        "sampled_shares": _array(index.sampled_shares),
        "alias_starts": _array(index.aliases.starts),
        "alias_turns": _array(index.aliases.turns),
        "wall_axes": _array(index.wall_axes),
        "descriptors": _array(views.steps),
        "descriptor_scale": _array(views.scale),
        "basis": _array(views.basis),
        "patch_weights": _array(views.weights),
        "pictures": pack_colors(_array(views.pictures), levels),
        "pictures_seen": np.packbits(_array(views.seen).astype(np.bool_), axis=-1),
    }
    if index.labels is not None:
        arrays |= {"labels": _array(index.labels.labels.int()), "label_codes": _array(index.labels.codes)}
    header = {
        "lower": lower.tolist(),
        "step": step,
        "origin_offset": index.origin_offset.tolist(),
        "spacing": index.spacing,
        "surface_thickness_m": index.surface_thickness_m,
        "num_points_read": index.num_points_read,
        "arrays": [{"name": k, "dtype": v.dtype.str, "shape": v.shape} for k, v in arrays.items()],
    }
    text = json.dumps(header).encode()
    # Little repeats: to look for more of it takes three times as long, and what is found is no shorter.
    compressor = zstandard.ZstdCompressor(level=1, write_checksum=True)
    body = compressor.compress(b"".join(v.tobytes() for v in arrays.values()))
    return _PREFIX.pack(_MAGIC, INDEX_VERSION, len(text)) + text + body


def decode_map_index(data: bytes, device: torch.device | str = "cpu") -> MapIndex:
    """Return the index of bytes made by `encode_map_index`. Raises IndexFormatError for anything else."""
    if len(data) < _PREFIX.size:
        raise IndexFormatError(
            f"map index: expected at least {_PREFIX.size} bytes, got {len(data)}; build it again from the scan"
        )
    magic, version, length = _PREFIX.unpack_from(data)
    if magic != _MAGIC or version != INDEX_VERSION:
        raise IndexFormatError(
            f"map index: expected version {INDEX_VERSION}, got {magic!r} {version}; build it again from the scan"
        )
    try:
        header = json.loads(data[_PREFIX.size : _PREFIX.size + length])
        index = _assemble(header, _arrays(header["arrays"], data[_PREFIX.size + length :]))
        _check_fit(index)
        return index.to(device)
    except _DAMAGE as error:
        raise IndexFormatError(
            f"map index: the bytes are damaged, or its arrays do not fit together ({error}); build it again from the scan"
        ) from error


def _arrays(entries: list[dict[str, Any]], compressed: bytes) -> dict[str, NDArray[np.generic]]:
    """Return the arrays by their names. Raises what damage leads to."""
    kinds = [(entry["name"], np.dtype(entry["dtype"]), tuple(entry["shape"])) for entry in entries]
    counts = [int(np.prod(shape, dtype=np.int64)) for _, _, shape in kinds]
    expected = sum(count * dtype.itemsize for count, (_, dtype, _) in zip(counts, kinds, strict=True))
    # As many bytes are allocated as the compressed ones say that they hold.
    if (held := zstandard.frame_content_size(compressed)) != expected:
        raise ValueError(f"expected {expected} bytes of arrays, got {held}")
    body, offset, arrays = zstandard.decompress(compressed), 0, {}
    for count, (name, dtype, shape) in zip(counts, kinds, strict=True):
        arrays[name] = np.frombuffer(body, dtype, count, offset).reshape(shape)
        offset += count * dtype.itemsize
    return arrays


def _assemble(header: dict[str, Any], arrays: dict[str, NDArray[np.generic]]) -> MapIndex:
    packed = {name: np.asarray(array, np.uint8) for name, array in arrays.items() if array.dtype == np.uint8}
    tensors = {name: torch.from_numpy(array.copy()) for name, array in arrays.items() if name not in packed}
    with np.errstate(over="ignore", invalid="ignore"):  # a damaged header; `_check_fit` refuses what comes of it
        steps = unpack_steps(packed["positions"]).astype(np.float32)
        positions = torch.from_numpy(steps * float(header["step"]) + np.asarray(header["lower"], np.float32))
    labels = LabelCodes(tensors["labels"], tensors["label_codes"]) if "labels" in tensors else None
    levels = _color_levels(labels)
    return MapIndex(
        positions=positions.contiguous(),
        colors=torch.from_numpy(unpack_colors(packed["colors"], levels)),
        origin_offset=np.asarray(header["origin_offset"], np.float64),
        spacing=float(header["spacing"]),
        starts=tensors["starts"],
        leaf_sizes=tensors["leaf_sizes"],
        sampled_shares=tensors["sampled_shares"],
        aliases=Aliases(tensors["alias_starts"], tensors["alias_turns"]),
        wall_axes=tensors["wall_axes"],
        surface_thickness_m=float(header["surface_thickness_m"]),
        labels=labels,
        num_points_read=int(header["num_points_read"]),
        views=DescribedViews(
            tensors["descriptors"],
            tensors["descriptor_scale"],
            tensors["basis"],
            tensors["patch_weights"],
            torch.from_numpy(unpack_colors(packed["pictures"], levels)),
            torch.from_numpy(np.unpackbits(packed["pictures_seen"], axis=-1).astype(np.bool_)),
        ),
    )


def _check_fit(index: MapIndex) -> None:
    """Raise ValueError when the arrays do not describe the same points, starts and patches."""
    views, points, starts = index.views, index.num_points, index.num_starts
    num_patches, size = views.steps.shape[1:]
    height = views.pictures.shape[1]
    expected: dict[str, tuple[Any, tuple[int, ...]]] = {
        "positions": (index.positions, (points, 3)),
        "colors": (index.colors, (points, 3)),
        "starts": (index.starts, (starts, 3)),
        "leaf_sizes": (index.leaf_sizes, (starts,)),
        "sampled_shares": (index.sampled_shares, (starts,)),
        "origin_offset": (index.origin_offset, (3,)),
        "alias_starts": (index.aliases.starts, (starts, index.aliases.turns.shape[1])),
        "alias_turns": (index.aliases.turns, (starts, index.aliases.turns.shape[1])),
        "wall_axes": (index.wall_axes, (3, 3)),
        "descriptors": (views.steps, (starts, num_patches, size)),
        "descriptor_scale": (views.scale, (starts,)),
        "basis": (views.basis, (len(views.basis), size)),
        "patch_weights": (views.weights, (starts, num_patches)),
        "pictures": (views.pictures, (starts, height, 2 * height, 3)),
        "pictures_seen": (views.seen, (starts, height, 2 * height)),
    }
    for name, (array, shape) in expected.items():
        if tuple(array.shape) != shape:
            raise ValueError(f"{name}: expected the shape {shape}, got {tuple(array.shape)}")
    if points == 0 or starts == 0:
        raise ValueError(f"expected points and starts, got {points} and {starts}")


def _color_levels(labels: LabelCodes | None) -> int:
    """Return how many steps a channel of the points' colours keeps: all where they are codes."""
    return _COLOR_LEVELS if labels is None else 256


def _array(tensor: Tensor) -> NDArray[Any]:
    return np.ascontiguousarray(tensor.detach().cpu().numpy())


def pack_steps(steps: NDArray[np.int64]) -> Bytes:
    """Return whole numbers (N, C) as planes of bytes (B, C, N): differences down the rows, small ones first.

    Rows that follow each other along a space-filling curve differ little, so that all but one or two planes are almost empty.
    """
    difference = np.diff(steps, axis=0, prepend=0)
    positive = (difference << 1) ^ (difference >> 63)
    planes = max(1, (int(positive.max(initial=0)).bit_length() + 7) // 8)
    split = np.ascontiguousarray(positive.T).astype("<u8")[..., None].view(np.uint8)
    return np.ascontiguousarray(split[..., :planes].transpose(2, 0, 1))


def unpack_steps(planes: Bytes) -> NDArray[np.int64]:
    """Undo `pack_steps`."""
    positive = np.zeros(planes.shape[1:], np.int64)
    for k, plane in enumerate(planes):
        if k == 0 or plane.any():
            positive |= plane.astype(np.int64) << (8 * k)
    difference = (positive >> 1) ^ -(positive & 1)
    return np.cumsum(difference, axis=1, out=difference).T


def pack_colors(colors: Bytes, levels: int) -> Bytes:
    """Return colours (..., N, 3) as planes (3, ..., N) of `levels` steps: green, and how far red and blue are from it.

    Of each number how it differs from the one before it, modulo 256.
    """
    red, green, blue = np.moveaxis((colors.astype(np.uint16) * (levels - 1) + 127) // 255, -1, 0).astype(np.uint8)
    return np.diff(np.stack((green, red - green, blue - green)), axis=-1, prepend=np.uint8(0))


def unpack_colors(planes: Bytes, levels: int) -> Bytes:
    """Undo `pack_colors` but for the rounding."""
    channels = torch.tensor(planes).cumsum(-1, dtype=torch.uint8).numpy()  # numpy would take eight times as long
    channels[1:] += channels[0]
    green, red, blue = (channels * np.uint16(255) + (levels - 1) // 2) // (levels - 1)
    return np.stack((red, green, blue), axis=-1, dtype=np.uint8, casting="unsafe")
