"""A scan that ends the service each time it is registered is given up; one that waits its turn is not."""

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from panoloc.service.cache import Cache
from panoloc.service.errors import NoWorkerError
from panoloc.service.jobs import PoolState, RegisterJob, RegisterOptions, RegisterOutcome
from panoloc.service.limits.registration_limits import MAX_ATTEMPTS, RegistrationLimits
from panoloc.service.maps.record import MapRecord, Revision, read_record
from panoloc.service.maps.registrations import Registrations
from panoloc.service.maps.registry import MapRegistry
from panoloc.service.metrics import Metrics
from panoloc.service.storage import FolderStorage

pytestmark = pytest.mark.anyio

REVISION = Revision(1, "maps/m/1/scan.ply", "scan.ply", 5_000_000, "00", RegisterOptions())
RECORD = MapRecord("m", "m", "2026-01-01T00:00:00.000000Z", "2026-01-01T00:00:00.000000Z", REVISION)


class AnsweringRedis:
    async def check(self) -> None:
        """Answer."""


class Pool:
    """Takes each registration's turn at once unless it is busy, and never comes to an end by itself."""

    def __init__(self, busy: bool = False, fails: bool = False) -> None:
        self.jobs: list[RegisterJob] = []
        self.num_held = 0
        self._busy, self._fails = busy, fails

    def state(self) -> PoolState:
        return PoolState(ready=True, waiting_for=None)

    async def register(self, job: RegisterJob, begin: Any) -> RegisterOutcome:
        if not self._busy:
            await begin()
        self.jobs.append(job)
        if self._fails:
            raise NoWorkerError("its process died", retry_after_s=0)
        self.num_held += 1
        try:
            await asyncio.Event().wait()
        finally:
            self.num_held -= 1
        raise AssertionError


class Service:
    """What one process of the service does with the maps of a folder."""

    def __init__(self, folder: Path, pool: Pool) -> None:
        self.storage = FolderStorage(folder)
        self._pool = pool
        self.registry = MapRegistry(self.storage, 10)
        metrics = Metrics(pool.state, self.registry.num_by_status)
        cache = cast(Cache, AnsweringRedis())
        self.registrations = Registrations(self.registry, cast(Any, pool), cache, metrics, RegistrationLimits())

    @property
    def newest(self) -> Revision:
        return read_record(self.storage, "m").newest

    async def begin(self) -> None:
        """Return when the pool has every registration, or none is left."""
        await self.registry.load()
        if not self.registry.has("m"):
            await self.registry.add(RECORD)
        self.registrations.resume()
        while len(self.registrations._running) > self._pool.num_held:
            await asyncio.sleep(0.005)


async def killed(service: Service) -> None:
    """Let a service begin its registrations and be gone without a word."""
    await service.begin()
    for task in service.registrations._running.values():
        task.cancel()
    await asyncio.gather(*service.registrations._running.values(), return_exceptions=True)


async def test_a_scan_that_ends_the_service_each_time_has_failed_after_some_attempts(tmp_path: Path) -> None:
    pool = Pool()
    for attempt in range(MAX_ATTEMPTS):
        await killed(service := Service(tmp_path, pool))
        assert (service.newest.status, service.newest.num_attempts) == ("queued", attempt + 1)
    await killed(service := Service(tmp_path, pool))
    assert len(pool.jobs) == MAX_ATTEMPTS
    assert service.newest.status == "failed"
    assert service.newest.error is not None
    assert service.newest.error["type"] == "/problems/registration-limit"


@pytest.mark.parametrize("orderly", [True, False])
async def test_neither_a_wait_for_others_nor_an_orderly_stop_is_an_attempt(tmp_path: Path, orderly: bool) -> None:
    service = Service(tmp_path, Pool(busy=not orderly))
    await service.begin()
    await (service.registrations.stop() if orderly else killed(service))
    assert (service.newest.status, service.newest.num_attempts) == ("queued", 0)


async def test_an_orderly_stop_takes_back_no_attempt_that_had_not_begun(tmp_path: Path) -> None:
    await killed(Service(tmp_path, Pool()))
    service = Service(tmp_path, Pool(busy=True))
    await service.begin()
    await service.registrations.stop()
    assert service.newest.num_attempts == 1


async def test_a_registration_whose_process_keeps_dying_is_tried_so_often_and_no_more(tmp_path: Path) -> None:
    pool = Pool(fails=True)
    service = Service(tmp_path, pool)
    await service.begin()
    assert len(pool.jobs) == MAX_ATTEMPTS
    assert service.newest.status == "failed"


@pytest.mark.parametrize(("unpacked_bytes", "counted_mb"), [(None, 5), (50_000_000, 50)])
async def test_the_time_of_a_registration_grows_with_its_scan_and_with_what_an_archive_unpacks_to(
    tmp_path: Path, unpacked_bytes: int | None, counted_mb: int
) -> None:
    service = Service(tmp_path, pool := Pool())
    await service.registry.add(replace(RECORD, newest=replace(REVISION, unpacked_bytes=unpacked_bytes)))
    await killed(service)
    limits = RegistrationLimits()
    assert [job.time_limit_s for job in pool.jobs] == [limits.time_s + counted_mb * limits.time_s_per_mb]
