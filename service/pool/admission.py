"""Admission control: how many requests may wait, and whether a request can be answered before its deadline."""

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from panoloc.service.errors import QueueFullError

# Weight of the newest duration in the running mean; before the first one of its kind a second is assumed.
_NEWEST, _FIRST_S = 0.2, 1.0
_LONGEST_RETRY_AFTER_S = 60
# Durations vary: a request is admitted when it would be done in time were all of them so much longer than their mean.
_CAUTION = 1.25


class Admission:
    """Counts the requests that wait or run. Used from one event loop, so it needs no lock."""

    def __init__(self, queue_limit: int) -> None:
        self._queue_limit = queue_limit
        self._num_workers = 1
        self._mean_duration_s: dict[str, float] = {}
        self._admitted: Counter[str] = Counter()

    @property
    def num_admitted(self) -> int:
        """Return how many requests wait or run."""
        return self._admitted.total()

    @property
    def queue_depth(self) -> int:
        """Return how many requests wait, one running per worker."""
        return max(0, self.num_admitted - self._num_workers)

    @property
    def retry_after_s(self) -> int:
        """Return in how many seconds a place should be free, at least 1."""
        return _within_reason(self._work_ahead_s())

    def set_num_workers(self, num_workers: int) -> None:
        """Set how many requests run at the same time."""
        self._num_workers = max(1, num_workers)

    def note_duration(self, duration_s: float, kind: str = "") -> None:
        """Record how long a worker computed for a request. kind: the key under which durations are averaged."""
        mean_s = self._mean_s(kind)
        self._mean_duration_s[kind] = mean_s + _NEWEST * (duration_s - mean_s)

    @contextmanager
    def admit(self, kind: str = "", remaining_s: float = math.inf) -> Iterator[None]:
        """Hold a place for the duration of the block.

        remaining_s: seconds until the deadline. Raises QueueFullError when the queue is full, and when the requests before this one
        leave it too little time. A request that need not wait is always admitted.
        """
        self._require(self._mean_s(kind), remaining_s)
        self._admitted[kind] += 1
        try:
            yield
        finally:
            self._admitted[kind] -= 1

    def require_place(self, longest_s: float) -> None:
        """Raise QueueFullError where the next request would be refused whatever it asks. longest_s: the longest deadline, in seconds."""
        self._require(0.0, longest_s)

    def _require(self, duration_s: float, remaining_s: float) -> None:
        """Raise QueueFullError when a request of this duration finds no place or would not end in time."""
        if self.num_admitted - self._num_workers >= self._queue_limit:
            raise QueueFullError(
                f"{self.queue_depth} requests are waiting, which is the limit; try again in {self.retry_after_s} s, "
                "or ask the operator to raise PANOLOC_QUEUE_LIMIT",
                self.retry_after_s,
            )
        needed_s = _CAUTION * (self._work_ahead_s() + duration_s)
        if self.num_admitted >= self._num_workers and needed_s > remaining_s:
            retry_after_s = _within_reason(needed_s - remaining_s)
            before = "1 request is" if self.num_admitted == 1 else f"{self.num_admitted} requests are"
            raise QueueFullError(
                f"expected an answer within the {remaining_s:.1f} s of timeout_s, but {before} ahead of this one "
                f"and the answer would take about {needed_s:.0f} s; try again in {retry_after_s} s, or allow more time",
                retry_after_s,
                "deadline",
            )

    def _work_ahead_s(self) -> float:
        return sum(count * self._mean_s(kind) for kind, count in self._admitted.items()) / self._num_workers

    def _mean_s(self, kind: str) -> float:
        return self._mean_duration_s.get(kind, _FIRST_S)


def _within_reason(seconds: float) -> int:
    return min(_LONGEST_RETRY_AFTER_S, max(1, math.ceil(seconds)))
