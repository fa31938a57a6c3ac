"""Time and peak memory of registering a scan, each time in a fresh process, so that the peak is that of the registration."""

import multiprocessing
import re
import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from panoloc.core.errors import CoreError
from panoloc.core.kernels.library import num_threads, use_threads
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.options import IndexOptions
from panoloc.core.scan.reading import read_scan
from panoloc.lab.benchmark.painted_maps import room_spacing, write_room_scan
from panoloc.lab.benchmark.painted_room import PaintedRoom
from panoloc.lab.benchmark.timing import Say, spread_of


class RegistrationFailedError(CoreError):
    """The process that registers a scan ended without figures."""


@dataclass(frozen=True)
class RegistrationFigures:
    """Seconds and bytes of one registration on the processor, as the service does it.

    seconds: by stage, and `total`. base_bytes: of the process before it began; peak_bytes: the most at any time.
    """

    scan_bytes: int
    points: int
    points_used: int
    starts: int
    index_bytes: int
    seconds: dict[str, float]
    base_bytes: int
    peak_bytes: int


def time_registration(points: int, starts: int, repeats: int, scan_format: str, say: Say) -> dict[str, Any]:
    """Write a scan of `points` points to a temporary file and register it `repeats` times.

    Return the RegistrationFigures whose total is the `median`, the Spread of all as `total`, and the greatest peak of any.
    Raises RegistrationFailedError when it does not go through, and OSError when the disk is full.
    """
    room, spacing_m = PaintedRoom(0), room_spacing(points, starts)
    with tempfile.TemporaryDirectory(prefix="panoloc-bench-") as folder:
        scan = Path(folder) / f"room.{scan_format}"
        write_room_scan(scan, room, points, say)
        found = []
        for number in range(repeats):
            say(f"registering {points:,} points ({scan_format}), {number + 1} of {repeats}")
            found.append(register_in_new_process(scan, spacing_m, num_threads()))
    totals = [each.seconds["total"] * 1000 for each in found]
    median = found[totals.index(statistics.median_low(totals))]
    return {
        "scan_format": scan_format,
        "median": asdict(median),
        "total": asdict(spread_of(totals)),
        "peak_bytes": max(each.peak_bytes for each in found),
    }


def register_in_new_process(scan: Path, spacing_m: float, threads: int) -> RegistrationFigures:
    """Register `scan` in a fresh process.

    Raises a ScanError for a file that cannot be read, and RegistrationFailedError when the process dies.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as processes:
        try:
            return processes.submit(register, scan, spacing_m, threads).result()
        except BrokenProcessPool as error:
            raise RegistrationFailedError(
                f"registration of {scan.name}: expected figures, but the process died; was there enough memory?"
            ) from error


def register(scan: Path, spacing_m: float, threads: int) -> RegistrationFigures:
    """Read, index and encode `scan` in this process. Raises a ScanError for a file that cannot be read."""
    from panoloc.core.map.map_codec import encode_map_index

    use_threads(threads)
    torch.set_num_threads(threads)
    base, began = memory_bytes()["RSS"], time.perf_counter()
    cloud = read_scan(scan)
    seconds = {"reading": time.perf_counter() - began}
    stages: list[tuple[str, float]] = []
    index = build_map_index(
        cloud,
        IndexOptions(spacing_m=spacing_m),
        progress=lambda stage, share: stages.append((stage, time.perf_counter())),
    )
    stages.append(("encoding", time.perf_counter()))
    encoded = encode_map_index(index)
    ended = time.perf_counter()
    # A stage lasts until the next report, whichever stage that is of.
    for (stage, at), (_, until) in zip(stages, [*stages[1:], ("", ended)], strict=True):
        seconds[stage] = seconds.get(stage, 0.0) + until - at
    seconds["total"] = ended - began
    return RegistrationFigures(
        scan_bytes=scan.stat().st_size,
        points=cloud.num_points_read,
        points_used=index.num_points,
        starts=index.num_starts,
        index_bytes=len(encoded),
        seconds=seconds,
        base_bytes=base,
        # The kernel counts in steps, so its peak may lie some pages below what it said at the start.
        peak_bytes=max(base, memory_bytes()["HWM"]),
    )


def memory_bytes() -> dict[str, int]:
    """Return the resident bytes (`RSS`) of this process and their peak (`HWM`).

    Not `resource.getrusage`, whose peak a process inherits from the one that started it.
    """
    found = re.findall(r"^Vm(HWM|RSS):\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    return {name: int(kilobytes) * 1024 for name, kilobytes in found}
