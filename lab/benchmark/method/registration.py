"""Register a scan file and say what it cost: run in a process of its own, so that its peak memory is that of the registration.

    python -m lab.benchmark.method.registration SCAN --spacing-m 0.5 [--threads 1]

prints one JSON document on standard output.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from core.errors import CoreError
from core.index.map_builder import build_map_index
from core.index.map_codec import encode_map_index
from core.options import IndexOptions
from core.scan.reading import read_scan

_ROOT = Path(__file__).resolve().parents[3]
_PAGE_LINES = {"VmHWM": "peak", "VmRSS": "resident"}


class RegistrationFailedError(CoreError):
    """The process that registers a scan ended without figures."""


@dataclass(frozen=True)
class RegistrationFigures:
    """Seconds and bytes of one registration on the processor, as the service does it.

    seconds: by stage, and `total`. base_bytes: of the process before it began; peak_bytes: the most at any time, None where the
    system does not tell.
    """

    scan_bytes: int
    points: int
    points_used: int
    starts: int
    index_bytes: int
    seconds: dict[str, float]
    base_bytes: int | None
    peak_bytes: int | None


def register_in_new_process(scan: Path, spacing_m: float, threads: int) -> RegistrationFigures:
    """Register `scan` in a fresh process. Raises RegistrationFailedError with the end of its messages."""
    command = [sys.executable, "-m", "lab.benchmark.method.registration", str(scan)]
    command += ["--spacing-m", repr(spacing_m), "--threads", str(threads)]
    path = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path})
    if done.returncode != 0:
        raise RegistrationFailedError(
            f"registration: expected figures, got exit code {done.returncode}: {done.stderr.strip()[-500:] or 'no message'}"
        )
    return RegistrationFigures(**json.loads(done.stdout))


def register(scan: Path, spacing_m: float) -> RegistrationFigures:
    """Read, index and encode `scan` in this process. Raises a ScanError for a file that cannot be read."""
    base, began = memory_bytes().get("resident"), time.perf_counter()
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
        peak_bytes=None if base is None else max(base, memory_bytes().get("peak", 0)),
    )


def memory_bytes() -> dict[str, int]:
    """Return `resident` and `peak` bytes of this process; empty where /proc is missing.

    Not `resource.getrusage`, whose peak a process inherits from the one that started it.
    """
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    pairs = (line.split(":", 1) for line in lines if ":" in line)
    return {_PAGE_LINES[name]: int(value.split()[0]) * 1024 for name, value in pairs if name in _PAGE_LINES}


def main() -> None:
    """Register the scan that the command line names."""
    parser = argparse.ArgumentParser(description="Register a scan file and say what it cost.")
    parser.add_argument("scan", type=Path)
    parser.add_argument("--spacing-m", type=float, required=True)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    print(json.dumps(asdict(register(arguments.scan, arguments.spacing_m))))


if __name__ == "__main__":
    main()
