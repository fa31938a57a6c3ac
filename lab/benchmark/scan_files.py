"""Writes scans of a painted room in pieces, so that 200 million points need little memory."""

from pathlib import Path

import numpy as np

from panoloc.core.errors import OptionsError
from panoloc.lab.benchmark.painted_room import PaintedRoom
from panoloc.lab.benchmark.timing import Say

_LAZ_STEP_M = 0.0005
_POINTS_PER_STATION = 5_000_000


def write_room_scan(path: Path, room: PaintedRoom, num_points: int, say: Say = lambda text: None) -> None:
    """Write a scan of `num_points` points in the format that the ending names: ply, laz or e57.

    say: receives what is being written. Raises OptionsError for another ending, and OSError when the disk is full.
    """
    write = {".ply": _write_ply, ".laz": _write_laz, ".e57": _write_e57}.get(path.suffix)
    if write is None:
        raise OptionsError(f"scan format: expected ply, laz or e57, got {path.suffix!r}")
    say(f"writing a scan of {num_points:,} points")
    write(path, room, num_points)


def _write_ply(path: Path, room: PaintedRoom, num_points: int) -> None:
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {num_points}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    with path.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        for positions, colors in room.scan_chunks(num_points):
            rows = np.empty(len(positions), [("position", "<f4", 3), ("color", "u1", 3)])
            rows["position"], rows["color"] = positions, colors
            file.write(rows.tobytes())


def _write_laz(path: Path, room: PaintedRoom, num_points: int) -> None:
    """Write LAZ 1.4 with colours of 16 bits."""
    import laspy

    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales = np.full(3, _LAZ_STEP_M)
    with laspy.open(path, mode="w", header=header, laz_backend=laspy.LazBackend.Lazrs) as file:
        for positions, colors in room.scan_chunks(num_points):
            points = laspy.ScaleAwarePointRecord.zeros(len(positions), header=header)
            points.x, points.y, points.z = positions.astype(np.float64).T
            points.red, points.green, points.blue = colors.astype(np.uint16).T * 257
            file.write_points(points)


def _write_e57(path: Path, room: PaintedRoom, num_points: int) -> None:
    """Write stations of five million points, each turned about a place of its own."""
    from pye57 import E57

    file = E57(str(path), mode="w")
    for number, first in enumerate(range(0, num_points, _POINTS_PER_STATION)):
        angle, place = 0.7 * number, np.array([1.0 + 0.1 * number, 1.5, 1.6])
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        cloud = room.scan(min(_POINTS_PER_STATION, num_points - first), seed=number)
        local = ((cloud.positions - place) @ turn).astype(np.float32).astype(np.float64)
        columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), local.T, strict=True))
        columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), cloud.colors.T, strict=True))
        rotation = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        file.write_scan_raw(columns, rotation=rotation, translation=place)
    file.close()
