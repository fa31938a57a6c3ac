"""Time and peak memory of registering a scan, each time in a fresh process."""

import statistics
import tempfile
from dataclasses import dataclass
from pathlib import Path

from lab.benchmark.method.registration import RegistrationFigures, register_in_new_process
from lab.benchmark.painted_room import PaintedRoom
from lab.benchmark.rooms import spacing_for
from lab.benchmark.scan_file import write_room_scan
from lab.benchmark.timing import Say, Spread, spread_of

_SAMPLE_POINTS = 100_000


@dataclass(frozen=True)
class RegistrationCost:
    """The registration whose total is the median, and the spread of all; peak_bytes: the most of any, None where not known."""

    median: RegistrationFigures
    total: Spread
    peak_bytes: int | None


def time_registration(points: int, starts: int, repeats: int, threads: int, say: Say) -> RegistrationCost:
    """Write a scan of `points` points to a temporary file and register it `repeats` times.

    Raises RegistrationFailedError when it does not go through, and OSError when the disk is full.
    """
    room = PaintedRoom(0)
    spacing_m = spacing_for(room.scan(min(points, _SAMPLE_POINTS)), starts)
    found = []
    with tempfile.TemporaryDirectory(prefix="panoloc-bench-") as folder:
        scan = Path(folder) / "room.ply"
        write_room_scan(scan, room, points, say)
        for number in range(repeats):
            say(f"registering {points:,} points, {number + 1} of {repeats}")
            found.append(register_in_new_process(scan, spacing_m, threads))
    totals = [each.seconds["total"] * 1000 for each in found]
    median = found[totals.index(statistics.median_low(totals))]
    peaks = [each.peak_bytes for each in found if each.peak_bytes is not None]
    return RegistrationCost(median, spread_of(totals), max(peaks, default=None))
