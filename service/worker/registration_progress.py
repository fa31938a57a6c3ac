"""Progress of a registration, published in Redis for `GET /maps/{id}`."""

import contextlib
import time

from panoloc.service.cache import WorkerCache
from panoloc.service.errors import CacheDownError
from panoloc.service.jobs import MapRef

_REPORT_PERIOD_S = 0.2
# Stages of `panoloc.core.index.map_builder`: name in `stats.seconds`, begin and end on the way from 0 to 1 (in
# furnished rooms).
_STAGES = {
    "reading": ("read", 0.0, 0.2),
    "finding starts": ("starts", 0.2, 0.25),
    "rendering starts": ("render", 0.25, 0.9),
    "describing views": ("describe", 0.9, 0.97),
    "storing": ("store", 0.97, 1.0),
}


class RegistrationProgress:
    """Publishes stages at most five times a second, and measures them. Works on without Redis."""

    def __init__(self, cache: WorkerCache | None, map_ref: MapRef) -> None:
        """cache: None to measure only."""
        self._cache = cache
        self._map_ref = map_ref
        self._stage: str | None = None
        self._stage_began = 0.0
        self._reported = 0.0
        self._seconds: dict[str, float] = {}

    def report(self, stage: str, share: float) -> None:
        """Publish that `share` (0 to 1) of `stage` is done."""
        if stage != self._stage:
            self._end_stage()
            self._stage, self._stage_began = stage, time.monotonic()
        elif time.monotonic() - self._reported < _REPORT_PERIOD_S:
            return
        self._reported = time.monotonic()
        self._write(stage, share)

    def finish(self) -> dict[str, float]:
        """Return the seconds of every stage."""
        self._end_stage()
        self._stage = None
        return self._seconds

    def _end_stage(self) -> None:
        if self._stage is not None:
            name, _, _ = _STAGES[self._stage]
            self._seconds[name] = self._seconds.get(name, 0.0) + time.monotonic() - self._stage_began

    def _write(self, stage: str, share: float) -> None:
        if self._cache is None:
            return
        _, begin, end = _STAGES[stage]
        status = "reading" if stage == "reading" else "indexing"
        with contextlib.suppress(CacheDownError):
            self._cache.report_progress(self._map_ref, status, stage, begin + (end - begin) * share)
