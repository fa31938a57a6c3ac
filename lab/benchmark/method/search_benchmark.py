"""Time the search alone: score maps and scores of all poses, for the `fast` and the `paper` method."""

from dataclasses import dataclass

import torch

from lab.benchmark.method.random_search import Search, make_search, score_maps
from lab.benchmark.sizes import Sizes
from lab.benchmark.timing import Say, Spread, spread_of, timed

METHODS = ("fast", "paper")


@dataclass(frozen=True)
class SearchTiming:
    """One search over `starts` x `rotations` poses for each of `color_models`, and the steps that it consists of.

    view_us: median microseconds of `total` per synthetic view, that is per start, rotation and colour model.
    """

    method: str
    starts: int
    rotations: int
    color_models: int
    tensor: Spread
    score_maps: Spread
    scores: Spread
    total: Spread
    view_us: float


def time_search(sizes: Sizes, device: torch.device, say: Say = lambda text: None) -> list[SearchTiming]:
    """Time `sizes.search_rows` for both methods; `say` hears which is under way."""
    found = []
    for method in METHODS:
        for starts, rotations, models in sizes.search_rows:
            say(f"search: {method}, {starts} starts, {rotations} rotations, {models} colour models")
            with torch.inference_mode():
                search = make_search(method, starts, rotations, device)
                found.append(_timing(search, (method, starts, rotations, models), sizes, device))
    return found


def _timing(search: Search, row: tuple[str, int, int, int], sizes: Sizes, device: torch.device) -> SearchTiming:
    """Time the steps of one search; each colour model goes through all of them before the next, as in a query."""
    times: list[tuple[float, float, float]] = []
    for _ in range(sizes.warm_ups + sizes.repeats):
        spent = (0.0, 0.0, 0.0)
        for _ in range(row[3]):
            one, tensor = timed(search.tensor, device)
            two, _ = timed(lambda tensor=tensor: score_maps(search, tensor), device)  # type: ignore[misc]
            three, _ = timed(lambda tensor=tensor: search.scores(tensor), device)  # type: ignore[misc]
            spent = (spent[0] + one, spent[1] + two, spent[2] + three)
        times.append(spent)
    counted = times[sizes.warm_ups :]
    tensor_ms, maps_ms, scores_ms = (spread_of(column) for column in zip(*counted, strict=True))
    total = spread_of([sum(spent) for spent in counted])
    return SearchTiming(*row, tensor_ms, maps_ms, scores_ms, total, total.median_ms * 1000 / (row[1] * row[2] * row[3]))
