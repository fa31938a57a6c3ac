"""A pool in an event loop of its own, driven from ordinary test functions."""

import asyncio
import gc
import json
import threading
import time
from collections.abc import Coroutine
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

from service.host.embedded_redis import EmbeddedRedis
from service.host.lifeline import Lifeline
from service.jobs import LocalizeJob, LocalizeOutcome, MapRef, QueryImage, QueryOptions, RegisterJob, RegisterOptions
from service.ray.cluster import RayCluster
from service.ray.front_doors import FrontDoors
from service.ray.pool import RayPool
from service.ray.queue.admission import Admission
from service.ray.serving import RayServing
from service.settings import Settings
from service.worker.plan import WorkerPlan, WorkerSettings

Result = TypeVar("Result")


class PoolInThread:
    """The real pool with a scripted worker."""

    def __init__(self, folder: Path, ray_address: str | None = None, redis_url: str | None = None) -> None:
        self.folder = folder
        self.lifeline = Lifeline()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self.redis = EmbeddedRedis(folder, self.lifeline)
        self.redis.start()
        scripted = "tests.integration.scripted_worker:ScriptedWorker"
        plan = WorkerPlan(
            WorkerSettings.of(Settings(data_dir=folder), redis_url or self.redis.url),
            worker=scripted,
            registrar=scripted,
        )
        front_doors = None if ray_address is None else FrontDoors(plan, None)
        introduction = None if front_doors is None else front_doors.introduction
        cluster = RayCluster(ray_address, folder / "ray", self.lifeline, introduction)
        self.admission = Admission(queue_limit=10)
        self.pool = self.run(self._build(cluster, RayServing(cluster, plan, None, front_doors)))
        self.run(self.pool.start())

    async def _build(self, cluster: RayCluster, serving: RayServing) -> RayPool:
        return RayPool(cluster, serving, self.admission)

    def begin(self, work: Coroutine[Any, Any, Result]) -> "Future[Result]":
        return asyncio.run_coroutine_threadsafe(work, self._loop)

    def run(self, work: Coroutine[Any, Any, Result], timeout_s: float = 240) -> Result:
        return self.begin(work).result(timeout_s)

    def wait_until_ready(self, within_s: float = 240) -> None:
        deadline = time.monotonic() + within_s
        while not self.pool.state().ready:
            assert time.monotonic() < deadline, self.pool.state()
            time.sleep(0.05)

    def localize(self, job: LocalizeJob) -> LocalizeOutcome:
        return self.run(self.pool.localize(job))

    def localize_all(self, jobs: list[LocalizeJob]) -> list[LocalizeOutcome | BaseException]:
        async def together() -> list[LocalizeOutcome | BaseException]:
            return await asyncio.gather(*(self.pool.localize(job) for job in jobs), return_exceptions=True)

        return self.run(together())

    def stop(self, drain_s: float = 5) -> None:
        self.run(self.pool.stop(drain_s))
        self.redis.stop()
        self.lifeline.close()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        gc.collect()  # what Ray leaves behind is warned of here, not in a test that comes later


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


def registration(name: str, **script: Any) -> RegisterJob:
    """Return a registration whose scan is named as the script of the worker."""
    scan_name = json.dumps(script)
    return RegisterJob(MapRef(name, 1), f"maps/{name}/1/scan.ply", scan_name, RegisterOptions(), f"register-{name}")
