"""A pool on a cluster of others that goes away and comes back. No real Ray."""

import asyncio
import threading
import time
from collections.abc import Coroutine
from dataclasses import replace
from typing import Any, cast

import pytest

from service.errors import NoWorkerError, QueueFullError
from service.jobs import LocalizeJob, LocalizeOutcome, MapRef, QueryOptions, RegisterJob, RegisterOptions
from service.ray import cluster_loss as loss_module
from service.ray import upkeep as upkeep_module
from service.ray.own_node import RayStartError
from service.ray.patience import GivenUpError
from service.ray.pool import RayPool
from service.ray.queue.admission import Admission
from service.worker.reply import WorkerReply
from tests.service.made_up_answers import empty_answer
from tests.service.ray.scripted_ray import ScriptedCluster, ScriptedServing

# Ray Serve's own models, not ours.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:ray")

OUTCOME = LocalizeOutcome(empty_answer())
SILENCE = "Ray's head does not answer at head:6379"


class JoinedCluster(ScriptedCluster):
    """Is silent while `fault` says so; leaving it ends the calls that hang, as Ray does."""

    def __init__(self) -> None:
        super().__init__()
        self.is_ours = False
        self.fault: str | None = None
        self.num_looks = 0
        self.left = threading.Event()
        self.test_is_over = threading.Event()

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
        """Answer no more, like most calls of Ray, which end when the cluster is left."""
        assert self.left.wait(10)
        raise SystemExit(0)

    def hang_for_ever(self) -> Any:
        """Answer no more, like some calls of Ray."""
        self.test_is_over.wait(60)

    def wait_patiently(self) -> Any:
        """Wait until the waiting is ended."""
        while not self.patience._is_over.is_set():
            time.sleep(0.01)
        raise GivenUpError("given up")

    def rehearse(self) -> None:
        super().rehearse()
        if self.fault is not None:
            raise RayStartError("Ray cannot be joined: connection refused")


@pytest.fixture(autouse=True)
def _in_little_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loss_module, "_WATCH_PERIOD_S", 0.02)
    monkeypatch.setattr(upkeep_module, "_WATCH_PERIOD_S", 0.02)
    monkeypatch.setattr(upkeep_module, "_RESTART_PAUSE_S", 0.05)
    monkeypatch.setattr(upkeep_module, "_UNSTICK_S", 0.3)
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


@pytest.mark.slow
@pytest.mark.parametrize("call", ["answers", "wait_patiently", "hang", "hang_for_ever"])
def test_who_waits_for_a_cluster_that_goes_away_is_told_and_it_is_joined_again(call: str) -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing(None, WorkerReply(OUTCOME))
        serving.tasks = [None]
        pool = await started(cluster, serving)
        query = asyncio.create_task(pool.localize(job()))
        registering = asyncio.create_task(pool.register(registration()))
        await until(lambda: serving.given and serving.references)
        if call != "answers":
            serving.running = getattr(cluster, call)
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
        cluster.test_is_over.set()

    run(scenario())


def test_an_answer_that_comes_at_the_moment_of_the_loss_makes_nothing_ready() -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing()
        pool, loop = await started(cluster, serving), asyncio.get_running_loop()

        def answer_while_it_goes(num_admitted: int) -> list[int]:
            if cluster.fault is None:
                cluster.fault = SILENCE
                loop.call_soon_threadsafe(pool._loss.fall_silent, SILENCE)
            return []

        serving.exchange_load = answer_while_it_goes  # type: ignore[method-assign]
        await until(lambda: not pool.state().ready)
        for _ in range(30):
            assert not pool.state().ready
            await asyncio.sleep(0.005)
        await pool.stop(drain_s=0)

    run(scenario())


def test_a_call_of_ray_that_ends_as_processes_do_ends_no_service() -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing(None)
        pool = await started(cluster, serving)
        ends = iter([SystemExit(0)])

        def end_once() -> int:
            for error in ends:
                raise error
            return 1

        serving.running = end_once
        await until(lambda: "Ray does not answer" in (pool.state().waiting_for or ""))
        await until(lambda: pool.state().ready)
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


@pytest.mark.slow
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


def test_what_waits_at_other_front_doors_counts_when_a_query_has_little_time() -> None:
    async def scenario() -> None:
        cluster, serving = JoinedCluster(), ScriptedServing(WorkerReply(OUTCOME, duration_s=1.0), None, None)
        pool = await started(cluster, serving)

        async def hear(load: list[int]) -> None:
            serving.load_of_others = load
            heard = serving.num_exchanges + 2
            await until(lambda: serving.num_exchanges > heard)

        await pool.localize(job())
        asking = asyncio.create_task(pool.localize(job()))
        await until(lambda: serving.told_load == 1)
        # Two and a half seconds for a worker of its own, with caution, and twice as many where it is one of three who ask.
        await hear([5, 0, 5])
        with pytest.raises(QueueFullError, match="take about 5 s"):
            await pool.localize(replace(job(), deadline_unix_s=time.time() + 4))
        await hear([0, 0])
        second = asyncio.create_task(pool.localize(replace(job(), deadline_unix_s=time.time() + 4)))
        await until(lambda: pool.num_under_way == 2)
        for each in (asking, second):
            each.cancel()
        await asyncio.gather(asking, second, return_exceptions=True)
        await pool.stop(drain_s=0)

    run(scenario())
