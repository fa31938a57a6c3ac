"""A pool on a cluster of others that goes away and comes back. No real Ray."""

import asyncio
import threading
import time
from collections.abc import Coroutine
from typing import Any, cast

import pytest

from service.errors import NoWorkerError
from service.jobs import LocalizeJob, LocalizeOutcome, MapRef, QueryOptions, RegisterJob, RegisterOptions
from service.ray import cluster_loss as loss_module
from service.ray import upkeep as upkeep_module
from service.ray.admission import Admission
from service.ray.own_node import RayStartError
from service.ray.pool import RayPool
from service.worker.reply import WorkerReply
from tests.service.ray.scripted_ray import ScriptedCluster, ScriptedServing

# Ray Serve's own models, not ours.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:ray")

OUTCOME = LocalizeOutcome("not_localized", None)
SILENCE = "Ray's head does not answer at head:6379"


class JoinedCluster(ScriptedCluster):
    """Is silent while `fault` says so; leaving it ends the calls that hang, as Ray does."""

    def __init__(self) -> None:
        super().__init__()
        self.is_ours = False
        self.fault: str | None = None
        self.num_looks = 0
        self.left = threading.Event()

    def silent(self) -> str | None:
        self.num_looks += 1
        return self.fault

    def connect(self) -> None:
        super().connect()
        self.left.clear()

    def disconnect(self) -> None:
        super().disconnect()
        self.left.set()

    def hang(self) -> Any:
        """Answer no more, like a call of Ray."""
        assert self.left.wait(10)
        raise SystemExit(0)

    def rehearse(self) -> None:
        super().rehearse()
        if self.fault is not None:
            raise RayStartError("Ray cannot be joined: connection refused")


@pytest.fixture(autouse=True)
def _in_little_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loss_module, "_WATCH_PERIOD_S", 0.02)
    monkeypatch.setattr(upkeep_module, "_WATCH_PERIOD_S", 0.02)
    monkeypatch.setattr(upkeep_module, "_RESTART_PAUSE_S", 0.05)
    monkeypatch.setattr("ray.cancel", lambda *_, **__: None)


def job() -> LocalizeJob:
    return LocalizeJob("loc_1", "req_1", (), (MapRef("map_a", 1),), QueryOptions(60), time.time() + 60)


def registration() -> RegisterJob:
    return RegisterJob(MapRef("map_a", 1), "key", "scan.ply", RegisterOptions(), "req_1")


async def until(holds: Any) -> None:
    async with asyncio.timeout(10):
        while not holds():
            await asyncio.sleep(0.005)


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(scenario, 20))


async def started(cluster: JoinedCluster, serving: ScriptedServing) -> RayPool:
    pool = RayPool(cast(Any, cluster), cast(Any, serving), Admission(3))
    await pool.start()
    await until(lambda: pool.state().ready)
    return pool


@pytest.mark.parametrize("hangs", [False, True], ids=["calls fail", "calls hang"])
def test_who_waits_for_a_cluster_that_goes_away_is_told_and_it_is_joined_again(hangs: bool) -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing(None, WorkerReply(OUTCOME))
        serving.tasks = [None]
        pool = await started(cluster, serving)
        query = asyncio.create_task(pool.localize(job()))
        registering = asyncio.create_task(pool.register(registration()))
        await until(lambda: serving.given and serving.references)
        if hangs:
            serving.running = cluster.hang
        cluster.fault = SILENCE
        for waiting in (query, registering):
            with pytest.raises(NoWorkerError, match="head does not answer at head:6379") as refused:
                await waiting
            assert refused.value.retry_after_s >= 1
        assert not pool.state().ready
        with pytest.raises(NoWorkerError):
            await pool.localize(job())
        assert pool.loss is None  # the service goes on
        serving.running = lambda: 1
        cluster.fault = None
        await until(lambda: pool.state().ready)
        assert await pool.localize(job()) == OUTCOME
        # Left once, and not joined before a try in another process had gone well.
        assert cluster.asked[:3] == ["rehearse", "connect", "disconnect"]
        assert cluster.asked[-2:] == ["rehearse", "connect"]
        assert cluster.asked.count("connect") == 2
        await pool.stop(drain_s=0)

    run(scenario())


def test_a_cluster_that_misses_one_look_is_not_given_up() -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing(None)
        pool = await started(cluster, serving)
        for _ in range(3):
            cluster.fault, before = SILENCE, cluster.num_looks
            await until(lambda before=before: cluster.num_looks > before)
            cluster.fault, before = None, cluster.num_looks
            await until(lambda before=before: cluster.num_looks > before + 1)
        assert "disconnect" not in cluster.asked
        assert pool.state().ready
        await pool.stop(drain_s=0)

    run(scenario())


def test_a_serve_that_is_silent_for_long_is_left_although_the_cluster_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(upkeep_module, "_SILENCE_S", 0.1)

    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing(None)
        pool = await started(cluster, serving)
        query = asyncio.create_task(pool.localize(job()))
        serving.running = cluster.hang
        with pytest.raises(NoWorkerError, match="Serve has not answered"):
            await query
        serving.running = lambda: 1
        await until(lambda: pool.state().ready)
        await pool.stop(drain_s=0)

    run(scenario())


def test_what_waits_for_its_turn_with_ray_is_not_asked_of_a_cluster_that_was_left() -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing()
        serving.tasks = [None]
        pool = await started(cluster, serving)
        serving.running = cluster.hang
        await asyncio.sleep(0.1)
        registering = asyncio.create_task(pool.register(registration()))  # behind the call that hangs
        await asyncio.sleep(0.05)
        cluster.fault = SILENCE
        with pytest.raises(NoWorkerError):
            await registering
        await until(lambda: "disconnect" in cluster.asked)
        await asyncio.sleep(0.1)
        assert serving.submitted == []
        await pool.stop(drain_s=0)

    run(scenario())


def test_workers_that_another_front_door_brings_up_are_waited_for_without_leaving() -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing()
        deploy, is_there = serving.deploy, threading.Event()
        serving.deploy = lambda: deploy() if is_there.is_set() else None  # type: ignore[method-assign,assignment,return-value]
        pool = RayPool(cast(Any, cluster), cast(Any, serving), Admission(3))
        await pool.start()
        await until(lambda: "another front door" in (pool.state().waiting_for or ""))
        is_there.set()
        await until(lambda: pool.state().ready)
        assert cluster.asked == ["rehearse", "connect"]
        await pool.stop(drain_s=0)

    run(scenario())


def test_how_many_run_at_the_same_time_follows_the_workers_that_are_up() -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing(*[None] * 5, num_workers=2)
        pool = await started(cluster, serving)
        asking = [asyncio.create_task(pool.localize(job())) for _ in range(3)]
        await until(lambda: pool.state().queue_depth == 1)
        serving.running = lambda: 1
        await until(lambda: pool.state().queue_depth == 2)
        serving.running = lambda: 0  # for a moment, in which it is not known how many there will be
        await until(lambda: not pool.state().ready)
        assert pool.state().queue_depth == 2
        for each in asking:
            each.cancel()
        await asyncio.gather(*asking, return_exceptions=True)
        await pool.stop(drain_s=0)

    run(scenario())
