"""Seconds per stage, and the deadline checked between stages."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch

from panoloc.core.errors import DeadlineExceededError


class StageClock:
    """Times named stages (a name used twice adds up) and raises DeadlineExceededError when a stage starts too late, or for nobody."""

    def __init__(
        self, timeout_s: float | None, device: torch.device, is_cancelled: Callable[[], bool] = lambda: False
    ) -> None:
        """is_cancelled: tells whether nobody waits for the answer any more."""
        self._started = time.monotonic()
        self._timeout_s, self._device, self._is_cancelled = timeout_s, device, is_cancelled
        self.timings_s: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under `name`."""
        self.check()
        began = time.monotonic()
        try:
            yield
        finally:
            if self._device.type == "cuda":
                torch.cuda.synchronize(self._device)
            self.timings_s[name] = self.timings_s.get(name, 0.0) + time.monotonic() - began

    def check(self) -> None:
        """Raise DeadlineExceededError when the timeout has passed, or nobody waits any more."""
        if self._is_cancelled():
            raise DeadlineExceededError("the query was cancelled")
        elapsed = time.monotonic() - self._started
        if self._timeout_s is not None and elapsed > self._timeout_s:
            raise DeadlineExceededError(
                f"no pose within {self._timeout_s:g} s (stopped after {elapsed:.1f} s); allow more time, give hints, or name fewer maps"
            )
