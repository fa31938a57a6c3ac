"""A pool in an event loop of its own, driven from ordinary test functions."""

import asyncio
import json
import threading
import time
from collections.abc import Coroutine
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from panoloc.service.jobs import (
    LocalizeJob,
    LocalizeOutcome,
    MapRef,
    QueryImage,
    QueryOptions,
    RegisterJob,
    RegisterOptions,
)
from panoloc.service.pool.process_pool import ProcessPool
from panoloc.service.settings import Settings
from panoloc.service.worker.plan import WorkerPlan
from tests.integration.running_service import eventually

Result = TypeVar("Result")


def scripted_plan(folder: Path) -> WorkerPlan:
    """Return a plan whose worker and registrar do what jobs tell them."""
    scripted = "tests.service.pool.scripted_worker:ScriptedWorker"
    plan = WorkerPlan.of(Settings(data_dir=folder), "redis://nowhere:1")
    return replace(plan, worker=scripted, registrar=scripted)


class PoolInThread:
    """A started pool. folder: where scripted workers leave their traces."""

    def __init__(self, folder: Path, pool: ProcessPool) -> None:
        self.folder = folder
        self.pool = pool
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self.run(self.pool.start())

    def begin(self, work: Coroutine[Any, Any, Result]) -> "Future[Result]":
        return asyncio.run_coroutine_threadsafe(work, self._loop)

    def run(self, work: Coroutine[Any, Any, Result], timeout_s: float = 240) -> Result:
        return self.begin(work).result(timeout_s)

    def wait_until_ready(self, within_s: float = 240) -> None:
        assert eventually(lambda: self.pool.state().ready, within_s), self.pool.state()

    def localize(self, job: LocalizeJob) -> LocalizeOutcome:
        return self.run(self.pool.localize(job))

    def begin_localizing(self, *jobs: LocalizeJob) -> "list[Future[LocalizeOutcome]]":
        return [self.begin(self.pool.localize(job)) for job in jobs]

    def stop(self, drain_s: float = 5) -> None:
        self.run(self.pool.stop(drain_s))
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


def query(name: str, maps: tuple[str, ...] = ("map_a",), timeout_s: float = 200, **script: Any) -> LocalizeJob:
    """Return a job whose image tells the scripted worker what to do."""
    return LocalizeJob(
        localization_id=f"loc_{name}",
        request_id=name,
        images=(QueryImage(json.dumps(script).encode()),),
        maps=tuple(MapRef(map_id, 1) for map_id in maps),
        options=QueryOptions(timeout_s),
        deadline_unix_s=time.time() + timeout_s,
    )


def registration(name: str, time_limit_s: float | None = None, **script: Any) -> RegisterJob:
    """Return a registration whose scan is named as the script of the worker."""
    scan_name = json.dumps(script)
    scan_key = f"maps/{name}/1/scan.ply"
    return RegisterJob(MapRef(name, 1), scan_key, scan_name, RegisterOptions(), f"register-{name}", time_limit_s)
