"""Write a point cloud as binary PLY."""

from pathlib import Path

import numpy as np

from panoloc.core.scan.point_cloud import PointCloud


def encode_ply(cloud: PointCloud) -> bytes:
    """Return `cloud` as a binary little-endian PLY file with its origin offset added back.

    Coordinates are float32, or double where an offset would not survive float32; colours are uchar.
    """
    has_offset = bool(np.any(cloud.origin_offset))
    scalar, name = ("<f8", "double") if has_offset else ("<f4", "float")
    rows = np.empty(len(cloud), [("position", scalar, 3), ("color", "u1", 3)])
    rows["position"] = cloud.positions.astype(np.float64) + cloud.origin_offset if has_offset else cloud.positions
    rows["color"] = cloud.colors
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}"]
    header += [f"property {name} {axis}" for axis in "xyz"]
    header += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    return ("\n".join([*header, "end_header"]) + "\n").encode("ascii") + rows.tobytes()


def write_ply(path: Path, cloud: PointCloud) -> None:
    """Write `cloud` to `path` as `encode_ply` does."""
    Path(path).write_bytes(encode_ply(cloud))
