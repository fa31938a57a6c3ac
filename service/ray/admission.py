"""How many requests may wait, and how long the next one would."""

import math
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import QueueFullError


class Admission:
    """Counts what is under way. Used from one event loop, so it needs no lock."""

    # Weight of the newest duration in the running mean; before the first one a second is assumed.
    _NEWEST = 0.2
    _LONGEST_RETRY_AFTER_S = 60

    def __init__(self, queue_limit: int) -> None:
        self._queue_limit = queue_limit
        self._num_workers = 1
        self._mean_duration_s = 1.0
        self._num_admitted = 0

    @property
    def num_admitted(self) -> int:
        """Return how many requests wait or run."""
        return self._num_admitted

    @property
    def queue_depth(self) -> int:
        """Return how many requests wait, one running per worker."""
        return max(0, self._num_admitted - self._num_workers)

    @property
    def retry_after_s(self) -> int:
        """Return in how many seconds a place should be free, at least 1."""
        expected = self._mean_duration_s * self._num_admitted / self._num_workers
        return min(self._LONGEST_RETRY_AFTER_S, max(1, math.ceil(expected)))

    def set_num_workers(self, num_workers: int) -> None:
        """Tell how many requests run at the same time."""
        self._num_workers = max(1, num_workers)

    def note_duration(self, duration_s: float) -> None:
        """Tell how long a worker took for a request."""
        self._mean_duration_s += self._NEWEST * (duration_s - self._mean_duration_s)

    @contextmanager
    def admit(self) -> Iterator[None]:
        """Hold a place for the duration of the block. Raises QueueFullError when there is none."""
        if self._num_admitted - self._num_workers >= self._queue_limit:
            raise QueueFullError(
                f"{self.queue_depth} requests are waiting, which is as many as may; try again in"
                f" {self.retry_after_s} s or raise PANOLOC_QUEUE_LIMIT",
                self.retry_after_s,
            )
        self._num_admitted += 1
        try:
            yield
        finally:
            self._num_admitted -= 1
