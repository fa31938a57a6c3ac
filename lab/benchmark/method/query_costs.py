"""What a whole query costs by stage, over one and over many maps, and against one quantity at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch

from core.config import LocalizerConfig, SearchConfig
from core.localizer import Localizer
from lab.benchmark.method.whole_query import QueryFigures, WholeQuery
from lab.benchmark.rooms import IndexedRoom, Rooms
from lab.benchmark.sizes import Sizes
from lab.benchmark.timing import Say

PARAMETERS = ("starts", "rotations", "points", "pixels", "maps")


@dataclass(frozen=True)
class QueryCost:
    """A query and its cost; starts and points over all maps."""

    maps: int
    starts: int
    rotations: int
    points: int
    pixels: int
    figures: QueryFigures


@dataclass(frozen=True)
class SweptCost:
    """One step of a sweep: the quantity that varied, its value, and the query."""

    parameter: str
    value: int
    query: QueryCost


def time_stages(sizes: Sizes, rooms: Rooms, device: torch.device, say: Say) -> QueryCost:
    """Time the stages of a query in a large room, pictures included."""
    room = rooms.indexed(0, sizes.points, sizes.starts)
    say("stages of a query")
    return _cost(_localizer(sizes, device), [room], sizes, sizes.width, sizes.repeats, pictures=True)


def time_maps(sizes: Sizes, rooms: Rooms, device: torch.device, say: Say) -> list[QueryCost]:
    """Time one query over few and many maps; the panorama is of the first, and those after a while come again."""
    return list(_over_maps(sizes.map_counts, sizes, rooms, device, say))


def time_scaling(sizes: Sizes, rooms: Rooms, device: torch.device, say: Say) -> Iterator[SweptCost]:
    """Time a query against starts, rotations, points, pixels and maps, each alone."""
    localizer, width = _localizer(sizes, device), sizes.base_width
    for starts in sizes.sweep_starts:
        room = rooms.indexed(0, sizes.base_points, starts, thinned=False)
        say(f"scaling: {room.index.num_starts} starts")
        yield SweptCost("starts", room.index.num_starts, _cost(localizer, [room], sizes, width))
    base = rooms.indexed(0, sizes.base_points, sizes.base_starts, thinned=False)
    for rotations in sizes.sweep_rotations:
        say(f"scaling: {rotations} rotations")
        more = _localizer(sizes, device, num_rotations=rotations)
        yield SweptCost("rotations", rotations, _cost(more, [base], sizes, width))
    for points in sizes.sweep_points:
        room = rooms.indexed(0, points, sizes.base_starts, thinned=False)
        say(f"scaling: {points:,} points")
        yield SweptCost("points", room.index.num_points, _cost(localizer, [room], sizes, width))
    for pixels in sizes.sweep_widths:
        say(f"scaling: {pixels} x {pixels // 2} pixels")
        yield SweptCost("pixels", pixels * pixels // 2, _cost(localizer, [base], sizes, pixels))
    for cost in _over_maps(sizes.sweep_maps, sizes, rooms, device, say):
        yield SweptCost("maps", cost.maps, cost)


def _over_maps(
    counts: Sequence[int], sizes: Sizes, rooms: Rooms, device: torch.device, say: Say
) -> Iterator[QueryCost]:
    localizer = _localizer(sizes, device)
    for count in counts:
        different = [
            rooms.indexed(seed, sizes.room_points, sizes.room_starts) for seed in range(min(count, sizes.num_rooms))
        ]
        say(f"one query over {count} maps")
        # The panorama's own room stands among them once: a second copy would be as right as the first.
        others = different[1:]
        maps = [different[0], *(others[number % len(others)] for number in range(count - 1))]
        yield _cost(localizer, maps, sizes, sizes.base_width)


def _localizer(sizes: Sizes, device: torch.device, num_rotations: int | None = None) -> Localizer:
    """Return a localizer with other numbers of candidates and rotations where there are any."""
    search = SearchConfig()
    search = replace(
        search,
        num_candidates=sizes.candidates or search.num_candidates,
        num_rotations=num_rotations or search.num_rotations,
    )
    return Localizer(LocalizerConfig(search=search), str(device))


def _cost(
    localizer: Localizer,
    maps: Sequence[IndexedRoom],
    sizes: Sizes,
    width: int,
    repeats: int | None = None,
    *,
    pictures: bool = False,
) -> QueryCost:
    """Time the query of a panorama taken in the first of `maps`; repeats: None for those of a sweep."""
    query = WholeQuery(localizer, maps[0], width, tuple(other.index for other in maps[1:]))
    return QueryCost(
        maps=len(maps),
        starts=sum(each.index.num_starts for each in maps),
        rotations=localizer.config.search.num_rotations,
        points=sum(each.index.num_points for each in maps),
        pixels=width * width // 2,
        figures=query.repeated(repeats or sizes.sweep_repeats, sizes.warm_ups, pictures=pictures),
    )
