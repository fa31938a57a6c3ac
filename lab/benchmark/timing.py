"""Milliseconds of a step, repeated: the median with its spread. Waits for CUDA before it looks at the clock."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

Say = Callable[[str], None]


@dataclass(frozen=True)
class Spread:
    """How long `num` repetitions took, milliseconds each."""

    num: int
    median_ms: float
    min_ms: float
    lower_quartile_ms: float
    upper_quartile_ms: float
    max_ms: float
    mean_ms: float
    p95_ms: float


def spread_of(values_ms: Sequence[float]) -> Spread:
    """Return the spread of at least one duration in milliseconds."""
    values = np.asarray(values_ms, np.float64)
    low, lower, median, upper, p95, high = np.quantile(values, (0, 0.25, 0.5, 0.75, 0.95, 1)).tolist()
    return Spread(len(values), median, low, lower, upper, high, float(values.mean()), p95)


def timed(step: Callable[[], object], device: torch.device) -> float:
    """Return the milliseconds of one call."""
    _wait_for(device)
    began = time.perf_counter()
    step()
    _wait_for(device)
    return (time.perf_counter() - began) * 1000


def repeated(step: Callable[[], object], repeats: int, device: torch.device, warm_ups: int) -> Spread:
    """Return the spread of `repeats` calls after `warm_ups` that are not counted."""
    for _ in range(warm_ups):
        step()
    return spread_of([timed(step, device) for _ in range(repeats)])


def _wait_for(device: torch.device) -> None:
    # Kernels run behind Python's back; work of before must not be charged to this step, nor this step's to the next.
    if device.type == "cuda":
        torch.cuda.synchronize(device)
