"""Every part gives the figures that it promises, positive and in agreement with each other. Nothing is said of how fast anything is."""

import json
from collections.abc import Iterator
from typing import Any

import pytest
import torch

from core.errors import OptionsError
from lab.benchmark.method.parts import CORE_PARTS, CoreBenchmark, chosen_device, run_core_part
from lab.benchmark.rooms import Rooms
from lab.benchmark.sizes import FULL, Sizes

Parts = dict[str, dict[str, Any]]
SPREAD = {"num", "median_ms", "min_ms", "lower_quartile_ms", "upper_quartile_ms", "max_ms", "mean_ms", "p95_ms"}


def spreads(figures: Any) -> Iterator[dict[str, Any]]:
    """Yield every spread anywhere in the figures."""
    if isinstance(figures, dict):
        if set(figures) == SPREAD:
            yield figures
        for value in figures.values():
            yield from spreads(value)
    if isinstance(figures, list | tuple):
        for value in figures:
            yield from spreads(value)


def whole_queries(parts: Parts) -> list[dict[str, Any]]:
    return [parts["stages"], *parts["maps"]["rows"], *(row["query"] for row in parts["scaling"]["rows"])]


@pytest.mark.slow
def test_all_figures_survive_json(parts: Parts) -> None:
    assert set(parts) == set(CORE_PARTS)
    json.dumps(parts, allow_nan=False)


@pytest.mark.slow
def test_the_values_of_every_spread_are_in_order(parts: Parts) -> None:
    found = list(spreads(parts))
    assert len(found) > 50
    for one in found:
        names = ("min_ms", "lower_quartile_ms", "median_ms", "upper_quartile_ms", "max_ms")
        values = [one[name] for name in names]
        assert one["num"] >= 1
        assert values[0] >= 0
        assert values == sorted(values)
        assert values[0] <= one["mean_ms"] <= values[-1]


@pytest.mark.slow
def test_a_search_takes_what_its_steps_take(parts: Parts, tiny: Sizes) -> None:
    rows = parts["search"]["rows"]
    measured = [(row["method"], row["starts"], row["rotations"], row["color_models"]) for row in rows]
    assert measured == [(method, *row) for method in ("fast", "paper") for row in tiny.search_rows]
    for row in rows:
        steps = sum(row[name]["mean_ms"] for name in ("tensor", "score_maps", "scores"))
        assert row["total"]["mean_ms"] == pytest.approx(steps)
        views = row["starts"] * row["rotations"] * row["color_models"]
        assert row["view_us"] * views == pytest.approx(row["total"]["median_ms"] * 1000)


@pytest.mark.slow
def test_a_whole_query_finds_the_pose_and_takes_longer_than_its_stages(parts: Parts) -> None:
    for query in whole_queries(parts):
        figures = query["figures"]
        stages = dict(figures["stages"])
        total = stages.pop("total")
        assert {"decode", "search", "refine"} <= set(stages)
        assert total["mean_ms"] >= sum(stage["mean_ms"] for stage in stages.values())
        # Tiny rooms are not found every time, but a pose is always there.
        assert figures["status"] in ("localized", "ambiguous", "not_localized")
        assert figures["position_error_m"] >= 0
        assert all(query[name] > 0 for name in ("maps", "starts", "rotations", "points", "pixels"))


@pytest.mark.slow
def test_the_stages_include_the_pictures(parts: Parts) -> None:
    assert {"draw pictures", "encode pictures"} <= set(parts["stages"]["figures"]["stages"])


@pytest.mark.slow
def test_a_registration_has_times_sizes_and_memory(parts: Parts, tiny: Sizes) -> None:
    small, large = parts["registration"]["rows"]
    assert (small["median"]["points"], large["median"]["points"]) == (tiny.points, 5_000)
    for row in (small, large):
        one = dict(row["median"])
        seconds = one.pop("seconds")
        total = seconds.pop("total")
        assert total * 1000 == pytest.approx(row["total"]["median_ms"])
        assert {"reading", "finding starts", "rendering starts", "encoding"} <= set(seconds)
        assert total >= sum(seconds.values())
        assert all(one[name] > 0 for name in ("scan_bytes", "points_used", "starts", "index_bytes"))
        assert row["peak_bytes"] >= one["peak_bytes"] >= one["base_bytes"] > 0


@pytest.mark.slow
def test_an_index_is_smaller_encoded_than_in_memory(parts: Parts) -> None:
    index = parts["index"]
    assert 0 < index["encoded_bytes"] < index["resident_bytes"]
    assert index["points"] == parts["stages"]["points"]


@pytest.mark.slow
def test_maps_are_as_many_as_asked_for_and_add_up(parts: Parts, tiny: Sizes) -> None:
    assert [row["maps"] for row in parts["maps"]["rows"]] == list(tiny.map_counts)
    assert parts["maps"]["rows"][0]["points"] == 2 * tiny.room_points


@pytest.mark.slow
def test_each_sweep_varies_its_own_quantity(parts: Parts) -> None:
    rows = parts["scaling"]["rows"]
    assert {row["parameter"] for row in rows} == {"starts", "rotations", "points", "pixels", "maps"}
    for row in rows:
        assert row["query"][row["parameter"]] == row["value"]


@pytest.mark.slow
def test_a_run_says_what_is_under_way(parts: Parts, heard: list[str]) -> None:
    assert any(text.startswith("search: fast") for text in heard)
    assert any(text.startswith("registering 5,000 points") for text in heard)


def test_full_sizes_are_those_of_the_documented_comparison() -> None:
    assert (100, 2304, 4) in FULL.search_rows
    assert (400, 2304, 4) in FULL.search_rows
    assert (FULL.points, FULL.width, FULL.map_counts) == (1_000_000, 2048, (1, 10, 100))


def test_a_part_that_is_none_is_named(tiny: Sizes) -> None:
    device = torch.device("cpu")
    with pytest.raises(OptionsError, match=r"part: expected one of search, .*got 'speed'"):
        run_core_part("speed", CoreBenchmark(tiny, device, Rooms(device)))


def test_a_device_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert chosen_device(None) == torch.device("cpu")
    with pytest.raises(OptionsError, match="expected a GPU that PyTorch can use, found none"):
        chosen_device("cuda")
    with pytest.raises(OptionsError, match="expected cpu or cuda, got 'tpu'"):
        chosen_device("tpu")
