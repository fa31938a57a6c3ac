"""Register large scans over HTTP, and say what all processes of the service together took for it.

    python -m lab.benchmark.service.large_scans laz e57 --points 200000000 --folder /var/tmp

writes a file of each kind as `lab.benchmark.method.large_scans` does, uploads it to a service of its own, and prints a JSON line per file.
`--keep` leaves the files there, and takes them as they are when they are there already.
"""

import argparse
import json
import sys
import time
from pathlib import Path

from lab.benchmark.method.large_scans import WRITERS, spacing_of_starts
from lab.benchmark.painted_room import PaintedRoom
from lab.benchmark.service.memory import PeakMemory, by_name
from lab.own_service import OwnService, own_service
from lab.process_memory import family_bytes
from service.client import JsonObject

_MB = 1e6


def measure(service: OwnService, scan: Path, spacing_m: float) -> JsonObject:
    """Register a scan, and return its figures: seconds by stage and memory (PSS) of all processes, before and at the most, in MB."""
    before = family_bytes(service.process_id)
    began = time.monotonic()
    with PeakMemory(service.process_id) as peak:
        place = service.client.register_map(scan, {"starts": {"spacing_m": round(spacing_m, 4)}})
        uploaded = time.monotonic()
        ready = service.client.wait_for_map(place["id"], timeout_s=24 * 3600.0)
        ended = time.monotonic()
    stats = ready["stats"]
    return {
        "scan": scan.name,
        "scan_mb": round(scan.stat().st_size / _MB),
        "points": stats["num_points"],
        "points_used": stats["num_points_used"],
        "starts": stats["num_starts"],
        "index_mb": round(stats["index_bytes"] / _MB, 1),
        "seconds": {
            "upload": round(uploaded - began, 1),
            **{name: round(seconds, 1) for name, seconds in stats["seconds"].items()},
            "total": round(ended - began, 1),
        },
        "idle_mb": round(sum(before.values()) / _MB),
        "peak_mb": round(peak.bytes / _MB),
        "peak_mb_by_process": _megabytes(peak.by_process),
        "after_mb_by_process": _megabytes(by_name(family_bytes(service.process_id))),
    }


def _megabytes(sizes: dict[str, int]) -> dict[str, int]:
    return {name: round(size / _MB) for name, size in sizes.items()}


def main(arguments: list[str]) -> int:
    """Measure the kinds that the command line names."""
    parser = argparse.ArgumentParser(description="Register large scans with a service, and say what that cost.")
    parser.add_argument("kinds", nargs="+", choices=sorted(WRITERS))
    parser.add_argument("--points", type=int, default=200_000_000)
    parser.add_argument("--folder", type=Path, required=True, help="for the files: 11 (LAZ) to 16 (E57) bytes a point")
    parser.add_argument("--keep", action="store_true", help="leave the files, and take those that are there")
    given = parser.parse_args(arguments)
    spacing_m = spacing_of_starts()
    for kind in given.kinds:
        scan = given.folder / f"scan-{given.points}.{kind}"
        began = time.monotonic()
        if not (given.keep and scan.exists()):
            WRITERS[kind](scan, PaintedRoom(0), given.points)
        written = time.monotonic() - began
        # A service of its own for each, so that neither has the other's memory.
        with own_service() as service:
            figures = measure(service, scan, spacing_m)
        print(json.dumps({**figures, "seconds_to_write": round(written, 1)}), flush=True)
        if not given.keep:
            scan.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
