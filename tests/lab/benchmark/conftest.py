"""One tiny run of every part of the benchmark, shared by the tests that look at its figures."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from lab.benchmark.method.parts import CORE_PARTS, CoreBenchmark, run_core_part
from lab.benchmark.method.registration import register
from lab.benchmark.rooms import Rooms
from lab.benchmark.sizes import QUICK, Sizes

torch.set_num_threads(1)

TINY = replace(
    QUICK,
    points=4_000,
    repeats=1,
    candidates=2,
    map_counts=(2,),
    sweep_starts=(8,),
    sweep_rotations=(288,),
    sweep_points=(3_000,),
    sweep_widths=(256,),
    sweep_maps=(1,),
)


@pytest.fixture(scope="session")
def tiny() -> Sizes:
    return TINY


@pytest.fixture(scope="session")
def heard() -> list[str]:
    """Return what the run said, in order."""
    return []


@pytest.fixture(scope="session")
def parts(heard: list[str]) -> dict[str, dict[str, Any]]:
    """Return the figures of every part by its name."""
    device = torch.device("cpu")
    run = CoreBenchmark(TINY, device, Rooms(device, heard.append), heard.append, large_points=5_000)
    with pytest.MonkeyPatch.context() as patch:
        # Importing torch anew for each registration would take longer than all else; test_registration.py starts the process.
        patch.setattr(
            "lab.benchmark.method.registration_benchmark.register_in_new_process",
            lambda scan, spacing_m, threads: register(scan, spacing_m),
        )
        return {name: run_core_part(name, run) for name in CORE_PARTS}
