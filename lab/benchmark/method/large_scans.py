"""Make a large scan of a painted room as LAZ or E57, register it in a process of its own, and say what that cost.

    python -m lab.benchmark.method.large_scans laz e57 --points 20000000 --folder /var/tmp

writes a file of each kind, several stations where the format has them, and prints one JSON line per file. Neither points nor files are ever
in memory as a whole.
"""

import argparse
import itertools
import json
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import OptionsError
from lab.benchmark.method.registration import memory_bytes, register_in_new_process
from lab.benchmark.painted_room import PaintedRoom
from lab.benchmark.rooms import spacing_for

_LAZ_STEP_M = 0.0005
_POINTS_PER_STATION = 5_000_000
_NUM_STARTS = 400
_SAMPLE_POINTS = 100_000
_WRITTEN_AT_ONCE = 1 << 20
_DRAWN_POINTS = 4_000_000
_RANGE_NOISE_M = 0.003

Chunk = tuple[NDArray[np.float32], NDArray[np.uint8]]


class LargeScan:
    """Points of a room without end.

    The same four million points come again and again, each time with other noise on their ranges: drawing them costs several times what
    writing them does.
    """

    def __init__(self, room: PaintedRoom, num_points: int):
        """num_points: how many will be asked for in all."""
        self._drawn = list(room.scan_chunks(min(num_points, _DRAWN_POINTS), chunk=_WRITTEN_AT_ONCE))
        self._random = np.random.default_rng((room.seed, 5))

    def chunks(self, num_points: int) -> Iterator[Chunk]:
        """Yield positions (n, 3) metres and colours (n, 3) of so many points."""
        left = num_points
        for positions, colors in itertools.cycle(self._drawn):
            noise = self._random.standard_normal(positions.shape, dtype=np.float32) * np.float32(_RANGE_NOISE_M)
            yield (positions + noise)[:left], colors[:left]
            left -= len(positions)
            if left <= 0:
                return


def write_laz(path: Path, room: PaintedRoom, num_points: int) -> None:
    """Write a scan of `num_points` points, colours of 16 bits."""
    import laspy

    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales = np.full(3, _LAZ_STEP_M)
    with laspy.open(path, mode="w", header=header, laz_backend=laspy.LazBackend.Lazrs) as file:
        for positions, colors in LargeScan(room, num_points).chunks(num_points):
            points = laspy.ScaleAwarePointRecord.zeros(len(positions), header=header)
            points.x, points.y, points.z = positions.astype(np.float64).T
            points.red, points.green, points.blue = colors.astype(np.uint16).T * 257
            file.write_points(points)


def write_e57(path: Path, room: PaintedRoom, num_points: int) -> None:
    """Write a scan of `num_points` points as stations of five million, each turned about its own place."""
    from pye57 import E57, libe57

    file, scan = E57(str(path), mode="w"), LargeScan(room, num_points)
    names = ("cartesianX", "cartesianY", "cartesianZ", "colorRed", "colorGreen", "colorBlue")
    columns = {name: np.empty(_WRITTEN_AT_ONCE) for name in names}
    for number, first in enumerate(range(0, num_points, _POINTS_PER_STATION)):
        count = min(_POINTS_PER_STATION, num_points - first)
        angle, place = 0.7 * number, np.array([1.0 + 0.1 * number, 1.5, 1.6])
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        points = _begin_station(libe57, file.image_file, file.data3d, angle, place)
        buffers = libe57.VectorSourceDestBuffer()
        for name in names:
            buffers.append(libe57.SourceDestBuffer(file.image_file, name, columns[name], _WRITTEN_AT_ONCE, True, True))
        writer = points.writer(buffers)
        for positions, colors in scan.chunks(count):
            local = (positions - place) @ turn
            for name, values in zip(names, (*local.T, *colors.T), strict=True):
                columns[name][: len(values)] = values
            writer.write(len(positions))
        writer.close()
    file.close()


def _begin_station(libe57: Any, image_file: Any, scans: Any, angle: float, place: Any) -> Any:
    """Add a scan of no points yet to an E57 file and return its points."""
    scan = libe57.StructureNode(image_file)
    scan.set("guid", libe57.StringNode(image_file, "{" + str(uuid.uuid4()) + "}"))
    pose, rotation, translation = (libe57.StructureNode(image_file) for _ in range(3))
    for name, value in zip("wxyz", (np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)), strict=True):
        rotation.set(name, libe57.FloatNode(image_file, float(value)))
    for name, value in zip("xyz", place, strict=True):
        translation.set(name, libe57.FloatNode(image_file, float(value)))
    pose.set("rotation", rotation)
    pose.set("translation", translation)
    scan.set("pose", pose)
    prototype = libe57.StructureNode(image_file)
    for axis in "XYZ":
        prototype.set(f"cartesian{axis}", libe57.FloatNode(image_file, 0.0, libe57.E57_SINGLE, -1e6, 1e6))
    for color in ("Red", "Green", "Blue"):
        prototype.set(f"color{color}", libe57.IntegerNode(image_file, 0, 0, 255))
    points = libe57.CompressedVectorNode(image_file, prototype, libe57.VectorNode(image_file, True))
    scan.set("points", points)
    scans.append(scan)
    return points


def spacing_of_starts() -> float:
    """Return the distance of starts, metres, that makes of any such scan a map of the usual size."""
    return spacing_for(PaintedRoom(0).scan(_SAMPLE_POINTS), _NUM_STARTS)


WRITERS: dict[str, Callable[[Path, PaintedRoom, int], None]] = {"laz": write_laz, "e57": write_e57}


def measure(kind: str, num_points: int, folder: Path | None, threads: int = 1) -> dict[str, Any]:
    """Write a scan of a kind, register it, remove it. Raises OptionsError for an unknown kind, OSError for a full disk."""
    if kind not in WRITERS:
        raise OptionsError(f"kind: expected one of {', '.join(WRITERS)}, got {kind!r}")
    spacing_m = spacing_of_starts()
    with tempfile.TemporaryDirectory(prefix="panoloc-large-", dir=folder) as place:
        path = Path(place) / f"scan.{kind}"
        began = time.perf_counter()
        WRITERS[kind](path, PaintedRoom(0), num_points)
        written = time.perf_counter() - began
        figures = register_in_new_process(path, spacing_m, threads)
    own = {"kind": kind, "seconds_to_write": round(written, 1), "peak_bytes_to_write": memory_bytes().get("peak")}
    return own | asdict(figures)


def main() -> None:
    """Measure the kinds that the command line names."""
    parser = argparse.ArgumentParser(description="Make large scans, register them and say what that cost.")
    parser.add_argument("kinds", nargs="+", choices=sorted(WRITERS))
    parser.add_argument("--points", type=int, default=20_000_000)
    parser.add_argument("--folder", type=Path, help="for the files: 6 (LAZ) to 16 (E57) bytes a point")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    for kind in arguments.kinds:
        print(json.dumps(measure(kind, arguments.points, arguments.folder, arguments.threads)), flush=True)


if __name__ == "__main__":
    main()
