"""A pool whose cluster loses a process: what callers are told, and that nothing waits for the dead. No real Ray."""

import asyncio
import time
from types import SimpleNamespace
from typing import Any

import pytest

from service.errors import NoWorkerError
from service.jobs import LocalizeJob, MapRef, QueryOptions, RegisterJob, RegisterOptions
from service.ray.pool import RayPool
from service.ray.queue.admission import Admission

# Ray Serve's own models, not ours.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:ray")


class FragileCluster:
    """Connects at once; `lost` is what it misses from then on."""

    def __init__(self) -> None:
        self.lost: str | None = None
        self.num_connects = 0
        self.is_left = False
        self.is_ours = True

    def connect(self) -> None:
        self.num_connects += 1

    def disconnect(self) -> None:
        self.is_left = True

    def remove_logs_of_ended(self) -> None:
        """Have none."""

    def missing_process(self) -> str | None:
        return self.lost


class SilentServing:
    """Has one worker, which takes queries and never answers."""

    told = ""

    def __init__(self) -> None:
        self.handle = SimpleNamespace(options=lambda **_: SimpleNamespace(localize=self))

    def remote(self, job: LocalizeJob) -> Any:
        return asyncio.get_running_loop().create_future()

    def unreachable(self) -> list[str]:
        return []

    def deploy(self) -> tuple[Any, Any]:
        return self.handle, SimpleNamespace(num_workers=1)

    def num_running(self) -> int:
        return 1

    def exchange_load(self, num_admitted: int) -> list[int]:
        return []

    def submit(self, *task: Any) -> Any:
        raise AssertionError("nothing is given to Ray after the loss")

    def retire(self) -> None:
        raise AssertionError("Ray is not asked for anything after the loss")


def job(timeout_s: float = 60) -> LocalizeJob:
    return LocalizeJob("loc_1", "req_1", (), (MapRef("map_1", 1),), QueryOptions(timeout_s), time.time() + timeout_s)


async def until(holds: Any) -> None:
    async with asyncio.timeout(10):
        while not holds():
            await asyncio.sleep(0.01)


async def lose(cluster: FragileCluster) -> tuple[RayPool, list[str], float]:
    """Return a pool that has just lost its raylet under a query, what happened in which order, and the seconds until it did."""
    happened: list[str] = []
    pool = RayPool(cluster, SilentServing(), Admission(queue_limit=3))  # type: ignore[arg-type]
    pool.call_on_loss(lambda: happened.append("told to end"))
    await pool.start()
    await until(lambda: pool.state().ready)
    query = asyncio.create_task(pool.localize(job()))
    await until(lambda: pool.num_under_way == 1)
    cluster.lost, began = "Ray's raylet (process 7) has ended", time.monotonic()
    with pytest.raises(NoWorkerError, match=r"raylet \(process 7\) has ended; try again") as refused:
        await query
    assert refused.value.retry_after_s >= 1
    return pool, happened, time.monotonic() - began


@pytest.mark.slow
def test_a_query_under_way_is_refused_long_before_its_deadline_and_the_server_is_told_once() -> None:
    async def scenario() -> None:
        pool, happened, took_s = await lose(FragileCluster())
        assert took_s < 5
        assert happened == ["told to end"]
        assert pool.loss == "Ray's raylet (process 7) has ended"
        assert not pool.state().ready
        await pool.stop(drain_s=30)

    asyncio.run(scenario())


@pytest.mark.slow
def test_afterwards_nothing_is_taken_and_the_end_waits_for_nothing() -> None:
    async def scenario() -> None:
        cluster = FragileCluster()
        pool, _, _ = await lose(cluster)
        with pytest.raises(NoWorkerError, match="the service ends"):
            await pool.localize(job())
        with pytest.raises(NoWorkerError, match="the service ends"):
            await pool.register(RegisterJob(MapRef("map_1", 1), "key", "scan.ply", RegisterOptions(), "req_1"))
        began = time.monotonic()
        await pool.stop(drain_s=30)
        assert time.monotonic() - began < 5
        assert cluster.num_connects == 1
        assert not cluster.is_left

    asyncio.run(scenario())
