"""Every part gives the figures that it promises, in agreement with each other. Nothing is said of how fast anything is."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from panoloc.core.config import StartsConfig
from panoloc.core.errors import ScanError
from panoloc.core.map.starts import octree_starts
from panoloc.lab.benchmark.core_parts import CORE_PARTS, CoreBenchmark
from panoloc.lab.benchmark.painted_maps import Rooms, spacing_for
from panoloc.lab.benchmark.painted_room import PaintedRoom
from panoloc.lab.benchmark.registration import register, register_in_new_process
from panoloc.lab.benchmark.sizes import QUICK
from panoloc.lab.benchmark.timing import spread_of, timed

ROOT = Path(__file__).resolve().parents[3]
Parts = dict[str, dict[str, Any]]
TINY = replace(QUICK, points=4_000, repeats=1, candidates=2, map_counts=(2,))


@pytest.fixture(scope="module")
def parts() -> Parts:
    """Return the figures of every part by its name."""
    device = torch.device("cpu")
    run = CoreBenchmark(TINY, device, Rooms(device), large_points=5_000, scan_formats=("laz",))
    with pytest.MonkeyPatch.context() as patch:
        # Importing torch anew for each registration would take longer than all else.
        patch.setattr("panoloc.lab.benchmark.registration.register_in_new_process", register)
        found = {name: measure(run) for name, measure in CORE_PARTS.items()}
    return dict(json.loads(json.dumps(found, allow_nan=False)))


@pytest.mark.slow
def test_a_whole_query_has_a_pose_and_takes_longer_than_its_stages(parts: Parts) -> None:
    for query in [parts["stages"], *parts["maps"]["rows"]]:
        stages = dict(query["stages"])
        total = stages.pop("total")
        assert {"decode", "search", "refine"} <= set(stages)
        assert total["mean_ms"] >= sum(stage["mean_ms"] for stage in stages.values())
        assert query["position_error_m"] >= 0
    (row,) = parts["maps"]["rows"]
    assert (row["maps"], row["points"]) == (2, 2 * TINY.room_points)
    assert {"draw pictures", "encode pictures"} <= set(parts["stages"]["stages"])


@pytest.mark.slow
def test_a_registration_has_times_sizes_and_memory(parts: Parts) -> None:
    small, large = parts["registration"]["rows"]
    assert (small["scan_format"], small["median"]["points"]) == ("ply", TINY.points)
    assert (large["scan_format"], large["median"]["points"]) == ("laz", 5_000)
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
def test_a_file_that_is_not_a_scan_raises_in_this_process_what_was_raised_in_the_other(tmp_path: Path) -> None:
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"no scan at all")
    with pytest.raises(ScanError):
        register_in_new_process(broken, 0.5, 1)


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [20, 400])
def test_the_spacing_puts_about_as_many_starts_into_a_room(wanted: int) -> None:
    cloud = PaintedRoom(0).scan(20_000)
    found = octree_starts(cloud.positions, StartsConfig(spacing_m=spacing_for(cloud, wanted), max_starts=10_000))
    assert 0.7 * wanted <= len(found) <= 1.3 * wanted


def test_a_spread_is_that_of_its_values() -> None:
    spread = spread_of([5.0, 1.0, 3.0, 2.0, 4.0])
    assert (spread.num, spread.median_ms, spread.min_ms, spread.max_ms, spread.mean_ms) == (5, 3, 1, 5, 3)
    assert (spread.lower_quartile_ms, spread.upper_quartile_ms) == (2, 4)
    assert spread.p95_ms == pytest.approx(4.8)


def test_cuda_is_waited_for_before_and_after(monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[str] = []
    monkeypatch.setattr(torch.cuda, "synchronize", lambda device: events.append("wait"))
    timed(lambda: events.append("step"), torch.device("cuda"))
    assert events == ["wait", "step", "wait"]


@pytest.mark.slow
def test_the_core_script_needs_torch_and_numpy_alone() -> None:
    script = ROOT / "tests" / "benchmarks" / "bench_core.py"
    others = (
        "PIL",
        "zstandard",
        "open3d",
        "laspy",
        "pye57",
        "typer",
        "rich",
        "ray",
        "httpx",
        "pydantic",
        "panoloc.service",
    )
    program = (
        "import runpy, sys\n"
        f"sys.modules.update(dict.fromkeys({others!r}))\n"
        f"sys.argv = ['bench_core', '--quick', '--part', 'stages', '--threads', '1']\n"
        f"runpy.run_path({str(script)!r}, run_name='__main__')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    stages = json.loads(done.stdout)["stages"]["stages"]
    assert "refine" in stages
    assert not {"decode", "draw pictures"} & set(stages)
