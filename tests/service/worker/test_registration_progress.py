import time

import pytest

from panoloc.service.errors import CacheDownError
from panoloc.service.jobs import MapRef
from panoloc.service.worker.registrar import RegistrationProgress

MAP = MapRef("map_a", 1)


class RecordingCache:
    """Remembers what was reported, and is away then, or not."""

    def __init__(self, is_away: bool = False) -> None:
        self.reports: list[tuple[str, float]] = []
        self._is_away = is_away

    def report_progress(self, ref: MapRef, status: str, stage: str, progress: float) -> None:
        assert ref == MAP
        self.reports.append((status, progress))
        if self._is_away:
            raise CacheDownError("no Redis")


def run_through(cache: RecordingCache) -> dict[str, float]:
    progress = RegistrationProgress(cache, MAP)  # type: ignore[arg-type]
    for stage in ("reading", "finding starts", "rendering starts", "describing views", "storing"):
        for share in (0.0, 0.5, 1.0):
            progress.report(stage, share)
            time.sleep(0.005)
    return progress.finish()


@pytest.mark.parametrize("is_away", [False, True])
def test_progress_only_grows_and_every_stage_is_measured_also_while_redis_is_away(is_away: bool) -> None:
    cache = RecordingCache(is_away)
    seconds = run_through(cache)
    shares = [share for _, share in cache.reports]
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert [status for status, _ in cache.reports] == ["reading"] + 4 * ["indexing"]
    assert list(seconds) == ["read", "starts", "render", "describe", "store"]
    assert all(0.01 < value < 1 for value in seconds.values())


def test_within_a_stage_it_reports_at_most_five_times_a_second() -> None:
    cache = RecordingCache()
    progress = RegistrationProgress(cache, MAP)  # type: ignore[arg-type]
    for step in range(1000):
        progress.report("reading", step / 1000)
    assert len(cache.reports) == 1
