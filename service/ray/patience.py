"""Waits for answers of Ray that can be given up: where a cluster is gone, Ray's own `get` waits, or computes, for ever."""

import math
import threading
import time
from typing import Any

_TURN_S = 0.5


class GivenUpError(Exception):
    """The cluster that was asked is given up."""


class Patience:
    """One asks, in the thread of Ray's calls; others end the waiting."""

    def __init__(self) -> None:
        self._is_over = threading.Event()

    def begin(self) -> None:
        """Wait for answers again."""
        self._is_over.clear()

    def end(self) -> None:
        """Let nobody wait any more."""
        self._is_over.set()

    def gotten(self, reference: Any, within_s: float = math.inf) -> Any:
        """Return what Ray's `get` gives. Raises TimeoutError, and GivenUpError soon after the `end`."""
        import ray
        from ray.exceptions import GetTimeoutError

        deadline = time.monotonic() + within_s
        while not self._is_over.is_set():
            try:
                return ray.get(reference, timeout=min(_TURN_S, max(0.0, deadline - time.monotonic())))
            except GetTimeoutError as error:
                if time.monotonic() >= deadline:
                    raise TimeoutError(f"Ray has not answered for {within_s:.0f} s") from error
        raise GivenUpError("the Ray cluster was given up while it was asked")
