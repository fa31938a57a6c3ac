"""The parts of the benchmark that need no service, by name. Each returns JSON-safe figures."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import torch

from core.errors import OptionsError
from lab.benchmark.method.index_benchmark import time_index
from lab.benchmark.method.query_costs import time_maps, time_scaling, time_stages
from lab.benchmark.method.registration_benchmark import time_registration
from lab.benchmark.method.search_benchmark import time_search
from lab.benchmark.rooms import Rooms
from lab.benchmark.sizes import Sizes
from lab.benchmark.timing import Say

Figures = dict[str, Any]


@dataclass(frozen=True)
class CoreBenchmark:
    """What the parts have in common. large_points: of a second scan to register, None for none. say: hears what is under way."""

    sizes: Sizes
    device: torch.device
    rooms: Rooms
    say: Say = lambda text: None
    large_points: int | None = None


def chosen_device(name: str | None) -> torch.device:
    """Return the device to compute on: CUDA where it is there when nothing is named.

    Raises OptionsError for a device that is not there.
    """
    if name not in (None, "cpu", "cuda"):
        raise OptionsError(f"device: expected cpu or cuda, got {name!r}")
    if name == "cuda" and not torch.cuda.is_available():
        raise OptionsError("device: expected a GPU that PyTorch can use, found none; leave --device out or say cpu")
    return torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))


def run_core_part(name: str, run: CoreBenchmark) -> Figures:
    """Measure one part. Raises OptionsError for a name that is none."""
    if name not in CORE_PARTS:
        raise OptionsError(f"part: expected one of {', '.join(CORE_PARTS)}, got {name!r}")
    return CORE_PARTS[name](run)


def _search(run: CoreBenchmark) -> Figures:
    rows = time_search(run.sizes, run.device, run.say)
    return {"rows": [asdict(row) for row in rows]}


def _stages(run: CoreBenchmark) -> Figures:
    return asdict(time_stages(run.sizes, run.rooms, run.device, run.say))


def _registration(run: CoreBenchmark) -> Figures:
    sizes, threads = run.sizes, torch.get_num_threads()
    rows = [time_registration(sizes.points, sizes.starts, sizes.sweep_repeats, threads, run.say)]
    if run.large_points is not None:
        rows.append(time_registration(run.large_points, sizes.starts, 1, threads, run.say))
    return {"rows": [asdict(row) for row in rows]}


def _index(run: CoreBenchmark) -> Figures:
    room = run.rooms.indexed(0, run.sizes.points, run.sizes.starts)
    run.say("encoding and decoding an index")
    return asdict(time_index(room.index, run.sizes, run.device))


def _maps(run: CoreBenchmark) -> Figures:
    return {"rows": [asdict(row) for row in time_maps(run.sizes, run.rooms, run.device, run.say)]}


def _scaling(run: CoreBenchmark) -> Figures:
    return {"rows": [asdict(row) for row in time_scaling(run.sizes, run.rooms, run.device, run.say)]}


CORE_PARTS: dict[str, Callable[[CoreBenchmark], Figures]] = {
    "search": _search,
    "stages": _stages,
    "registration": _registration,
    "index": _index,
    "maps": _maps,
    "scaling": _scaling,
}
