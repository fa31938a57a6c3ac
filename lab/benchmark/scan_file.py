"""Write the scan of a painted room as a binary PLY in pieces, so that 50 million points need no memory."""

from pathlib import Path

import numpy as np

from lab.benchmark.painted_room import PaintedRoom
from lab.benchmark.timing import Say


def write_room_scan(path: Path, room: PaintedRoom, num_points: int, say: Say = lambda text: None) -> None:
    """Write a scan of `num_points` points; `say` hears how many are written."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {num_points}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    written = 0
    with path.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        for positions, colors in room.scan_chunks(num_points):
            rows = np.empty(len(positions), [("position", "<f4", 3), ("color", "u1", 3)])
            rows["position"], rows["color"] = positions, colors
            file.write(rows.tobytes())
            written += len(positions)
            say(f"writing a scan: {written:,} of {num_points:,} points")
