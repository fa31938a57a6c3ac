"""Proportional memory of a service's processes together: idle, while it answers, and idle again."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from lab.benchmark.request import BenchRequest
from lab.benchmark.timing import Say
from lab.process_memory import family_bytes

_SAMPLE_S = 0.5


@dataclass(frozen=True)
class MemoryFigures:
    """Bytes (PSS) of all processes of a service together, and of those of the same name; peak: of samples every half second."""

    queries: int
    idle_bytes: int
    peak_bytes: int
    after_bytes: int
    idle_by_process: dict[str, int]
    after_by_process: dict[str, int]


def measure_memory(process_id: int, request: BenchRequest, say: Say, send: Callable[[int], object]) -> MemoryFigures:
    """Measure the processes below and with `process_id` around `send`, which is told how many queries to send."""
    say("memory of the idle service")
    time.sleep(request.settle_s)
    idle = by_name(family_bytes(process_id))
    say(f"memory under {request.num_queries} queries")
    with PeakMemory(process_id) as peak:
        send(request.num_queries)
    say("memory of the service, idle again")
    time.sleep(request.settle_s)
    after = by_name(family_bytes(process_id))
    most = max(peak.bytes, sum(idle.values()), sum(after.values()))
    return MemoryFigures(request.num_queries, sum(idle.values()), most, sum(after.values()), idle, after)


def by_name(processes: dict[str, int]) -> dict[str, int]:
    """Return the bytes of processes `"<pid> <name>"` added up by name, the largest first."""
    found: dict[str, int] = {}
    for process, size in processes.items():
        name = process.partition(" ")[2]
        if name.startswith("ray::"):
            # Ray adds what a worker does at the moment: ray::ServeReplica:panoloc:localizer.check_health
            name = name.partition(".")[0]
        found[name] = found.get(name, 0) + size
    return dict(sorted(found.items(), key=lambda entry: -entry[1]))


class PeakMemory:
    """Samples the proportional memory of a process and everything below it in a thread while the block runs.

    bytes: the most that they took together; by_process: what each took then, by name.
    """

    def __init__(self, process_id: int) -> None:
        self.bytes = 0
        self.by_process: dict[str, int] = {}
        self._process_id = process_id
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._sample, name="memory", daemon=True)

    def __enter__(self) -> "PeakMemory":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._ended.is_set():
            found = family_bytes(self._process_id)
            if sum(found.values()) > self.bytes:
                self.bytes, self.by_process = sum(found.values()), by_name(found)
            self._ended.wait(_SAMPLE_S)
