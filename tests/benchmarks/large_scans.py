"""`python -m tests.benchmarks.large_scans [--points N] [--folder DIR]`: how long a large scan takes, and how much memory.

Makes a LAZ, and an E57 of 40 stations, of a painted hall, chunk by chunk, then reads each and builds its map in a process of its own.
Prints points, bytes, seconds and the peak memory of that process. Files that are there already are not made again.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np

from core.index.map_builder import build_map_index
from core.options import ScanOptions
from core.scan.point_cloud import PointCloud
from core.scan.reading import read_scan
from tests.core.painted_box import PaintedBox

_HALL = PaintedBox(seed=3, size_m=(40.0, 30.0, 6.0))
_NUM_STATIONS = 40
_MB = 1e6


def chunks(num_points: int) -> Iterator[PointCloud]:
    """Yield the points of each station."""
    for station in range(_NUM_STATIONS):
        yield _HALL.scan(num_points // _NUM_STATIONS, seed=station)


def write_laz(path: Path, num_points: int) -> None:
    """Write a LAZ with 16-bit colours, to the millimetre."""
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales = np.full(3, 0.001)
    with laspy.open(path, mode="w", header=header) as writer:
        for cloud in chunks(num_points):
            record = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=header)
            record.x, record.y, record.z = cloud.positions.astype(np.float64).T
            record.red, record.green, record.blue = cloud.colors.astype(np.uint16).T * 256
            writer.write_points(record)


def write_e57(path: Path, num_points: int) -> None:
    """Write an E57 of as many stations as there are chunks."""
    from pye57 import E57

    file = E57(str(path), mode="w")
    for number, cloud in enumerate(chunks(num_points)):
        columns = dict(
            zip(("cartesianX", "cartesianY", "cartesianZ"), cloud.positions.astype(np.float64).T, strict=True)
        )
        columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), cloud.colors.T, strict=True))
        file.write_scan_raw(columns, name=f"station {number}")
    file.close()


def measure(path: Path) -> dict[str, float]:
    """Read a scan and build its map; return seconds of the processor and by the clock, and the peak of this process's memory in bytes."""
    began, began_cpu = time.perf_counter(), time.process_time()
    cloud = read_scan(path, ScanOptions(max_points_used=500_000))
    read_peak = _peak_bytes()
    read_s, read_cpu_s = time.perf_counter() - began, time.process_time() - began_cpu
    index = build_map_index(cloud)
    return {
        "num_points": cloud.num_points_read,
        "num_points_used": index.num_points,
        "read_s": read_s,
        "read_cpu_s": read_cpu_s,
        "total_s": time.perf_counter() - began,
        "total_cpu_s": time.process_time() - began_cpu,
        "read_peak_bytes": read_peak,
        "peak_bytes": _peak_bytes(),
    }


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def main(arguments: list[str]) -> int:
    """Make the files that are missing, and measure each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=200_000_000)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.measure is not None:
        print(json.dumps(measure(given.measure)))
        return 0
    for name, write in (("laz", write_laz), ("e57", write_e57)):
        path = given.folder / f"hall-{given.points}.{name}"
        if not path.exists():
            write(path.with_suffix(f".part.{name}"), given.points)
            path.with_suffix(f".part.{name}").rename(path)
        command = [sys.executable, "-m", "tests.benchmarks.large_scans", "--measure", str(path)]
        found = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        read = f"read in {found['read_s']:.0f} s ({found['read_cpu_s']:.0f} s of a processor)"
        whole = f"map after {found['total_s']:.0f} s ({found['total_cpu_s']:.0f} s)"
        peaks = f"peak {found['read_peak_bytes'] / _MB:,.0f} MB of reading, {found['peak_bytes'] / _MB:,.0f} MB in all"
        size = f"{found['num_points']:,} points, {path.stat().st_size / _MB:,.0f} MB"
        print(f"{name}: {size}: {read}, {whole}, {peaks}, {found['num_points_used']:,} points used", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
