"""The parts of the benchmark that need no service, by name. Each returns JSON-safe figures."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from typing import Any

import torch

from panoloc.core.config import LocalizerConfig, SearchConfig
from panoloc.core.errors import OptionsError
from panoloc.core.localizer import Localizer
from panoloc.lab.benchmark.painted_maps import Rooms
from panoloc.lab.benchmark.registration import time_registration
from panoloc.lab.benchmark.sizes import Sizes
from panoloc.lab.benchmark.timing import Say, repeated
from panoloc.lab.benchmark.whole_query import time_query

Figures = dict[str, Any]


@dataclass(frozen=True)
class CoreBenchmark:
    """What the parts have in common.

    say: receives what is under way. large_points: of further scans to register, one in each of scan_formats (ply, laz, e57); None for
    none.
    """

    sizes: Sizes
    device: torch.device
    rooms: Rooms
    say: Say = lambda text: None
    large_points: int | None = None
    scan_formats: tuple[str, ...] = ("ply",)

    @property
    def localizer(self) -> Localizer:
        """Return a localizer that searches as many candidates as the sizes say."""
        search = SearchConfig()
        search = replace(search, num_candidates=self.sizes.candidates or search.num_candidates)
        return Localizer(LocalizerConfig(search=search), str(self.device))


def chosen_device(name: str | None) -> torch.device:
    """Return the device to compute on: CUDA where it is there when nothing is named.

    Raises OptionsError for a device that is not there.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise OptionsError("device: expected a GPU that PyTorch can use, found none; leave --device out or say cpu")
    return torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))


def _stages(run: CoreBenchmark) -> Figures:
    """Time the stages of a query in a large room, pictures included."""
    sizes = run.sizes
    room = run.rooms.indexed(0, sizes.points, sizes.starts)
    run.say("stages of a query")
    return asdict(time_query(run.localizer, [room], sizes.width, sizes.repeats, sizes.warm_ups, pictures=True))


def _registration(run: CoreBenchmark) -> Figures:
    sizes = run.sizes
    rows = [time_registration(sizes.points, sizes.starts, sizes.few_repeats, "ply", run.say)]
    if run.large_points is not None:
        rows += [time_registration(run.large_points, sizes.starts, 1, each, run.say) for each in run.scan_formats]
    return {"rows": rows}


def _index(run: CoreBenchmark) -> Figures:
    """Time encoding a map index, and decoding it up to the arrays on the device. Needs zstandard."""
    from panoloc.core.map.map_codec import decode_map_index, encode_map_index

    sizes = run.sizes
    index = run.rooms.indexed(0, sizes.points, sizes.starts).index
    run.say("encoding and decoding an index")
    encoded = encode_map_index(index)
    times = sizes.repeats, run.device, sizes.warm_ups
    return {
        "points": index.num_points,
        "starts": index.num_starts,
        "encoded_bytes": len(encoded),
        "resident_bytes": index.num_bytes,
        "encode": asdict(repeated(lambda: encode_map_index(index), *times)),
        "decode": asdict(repeated(lambda: decode_map_index(encoded, run.device), *times)),
    }


def _maps(run: CoreBenchmark) -> Figures:
    """Time one query over few and many maps; the panorama is of the first, and those after a while come again."""
    sizes, rows = run.sizes, []
    for count in sizes.map_counts:
        seeds = range(min(count, sizes.num_rooms))
        different = [run.rooms.indexed(seed, sizes.room_points, sizes.room_starts) for seed in seeds]
        run.say(f"one query over {count} maps")
        # The panorama's own room stands among them once: a second copy would be as right as the first.
        others = different[1:]
        rooms = [different[0], *(others[number % len(others)] for number in range(count - 1))]
        rows.append(time_query(run.localizer, rooms, sizes.room_width, sizes.few_repeats, sizes.warm_ups))
    return {"rows": [asdict(row) for row in rows]}


CORE_PARTS: dict[str, Callable[[CoreBenchmark], Figures]] = {
    "stages": _stages,
    "registration": _registration,
    "index": _index,
    "maps": _maps,
}


def measurable_parts() -> list[str]:
    """Return the names of the parts that this environment can measure: without zstandard none that encodes an index."""
    return [name for name in CORE_PARTS if find_spec("zstandard") or name not in ("registration", "index")]
