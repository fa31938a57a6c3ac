"""What the pool makes of workers that answer, die, miss an index or keep silent. No real Ray."""

import asyncio
import logging
import threading
import time
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any, cast

import pytest
from ray.exceptions import ActorDiedError, RayTaskError
from ray.serve.exceptions import RayServeException

from core.camera.camera import CameraDescription
from core.errors import DeadlineExceededError
from service.errors import NoWorkerError, QueueFullError, WorkerError
from service.jobs import (
    LocalizeJob,
    LocalizeOutcome,
    MapRef,
    QueryImage,
    QueryOptions,
    RegisterJob,
    RegisterOptions,
    RegisterOutcome,
)
from service.ray import upkeep as upkeep_module
from service.ray.own_node import RayStartError
from service.ray.pool import RayPool
from service.ray.queue.admission import Admission
from service.worker.reply import WorkerFailure, WorkerReply
from tests.service.made_up_answers import empty_answer
from tests.service.ray.scripted_ray import ScriptedCluster, ScriptedServing

# Ray Serve's own models, not ours.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:ray")

OUTCOME = LocalizeOutcome(empty_answer())
MAP, OTHER = MapRef("map_a", 1), MapRef("map_b", 3)


def reply(outcome: Any = OUTCOME, **figures: Any) -> WorkerReply[Any]:
    return WorkerReply(outcome, **figures)


def missing(*maps: MapRef) -> WorkerReply[Any]:
    return WorkerReply(missing=maps)


def job(timeout_s: float = 30, maps: tuple[MapRef, ...] = (MAP,)) -> LocalizeJob:
    return LocalizeJob("loc_1", "req_1", (), maps, QueryOptions(timeout_s), time.time() + timeout_s)


def registration() -> RegisterJob:
    return RegisterJob(MapRef("map_a", 1), "key", "scan.ply", RegisterOptions(), "req_1")


async def until(holds: Any) -> None:
    async with asyncio.timeout(10):
        while not holds():
            await asyncio.sleep(0.005)


@asynccontextmanager
async def running(serving: ScriptedServing, queue_limit: int = 3) -> AsyncIterator[RayPool]:
    pool = RayPool(cast(Any, ScriptedCluster()), cast(Any, serving), Admission(queue_limit))
    await pool.start()
    await until(lambda: pool.state().ready)
    yield pool
    await pool.stop(drain_s=0)


@pytest.fixture(autouse=True)
def ended_tasks(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Collect the tasks that Ray is told to end; the real call would start a cluster."""
    ended: list[Any] = []
    monkeypatch.setattr("ray.cancel", lambda reference, **_: ended.append(reference))
    return ended


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(scenario, 20))


# Answers.


def test_a_query_is_answered_and_sent_where_its_maps_are_resident() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(reply())
        async with running(serving) as pool:
            asked = job(maps=(MAP, OTHER))
            assert await pool.localize(asked) == OUTCOME
            assert serving.jobs == [asked]
            assert serving.routed_by == ["map_a:1,map_b:3"]
            assert pool.num_under_way == 0

    run(scenario())


def test_searches_of_a_field_of_view_are_no_reason_to_refuse_other_queries() -> None:
    async def scenario() -> None:
        camera = CameraDescription("pinhole", hfov_range_deg=(45.0, 90.0))
        searching = replace(job(timeout_s=600), images=(QueryImage(b"", camera=camera),))
        async with running(ScriptedServing(reply(duration_s=10_000.0), None, reply())) as pool:
            await pool.localize(searching)
            before = asyncio.create_task(pool.localize(job()))
            await until(lambda: pool.num_under_way == 1)
            # Nobody expects the one before to take as long as that search.
            assert await pool.localize(job(timeout_s=5)) == OUTCOME
            before.cancel()

    run(scenario())


def test_the_state_tells_what_workers_said_of_themselves() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(
            reply(worker="one", resident_bytes=10, index_loads={"redis": 1}),
            reply(worker="two", resident_bytes=200, index_loads={"redis": 1, "resident": 2}),
            reply(worker="one", resident_bytes=3000, index_loads={"resident": 1}),
            num_workers=2,
        )
        async with running(serving) as pool:
            for _ in range(3):
                await pool.localize(job())
            state = pool.state()
            assert (state.ready, state.waiting_for, state.num_workers) == (True, None, 2)
            assert state.resident_bytes == 3200
            assert state.index_loads == {"redis": 2, "resident": 3}
            assert (state.num_retries, state.queue_depth) == (0, 0)

    run(scenario())


def test_what_a_worker_raised_is_raised_here_and_its_own_faults_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        faults = [
            WorkerFailure("ZeroDivisionError", "by zero", "Traceback: here"),
            WorkerFailure("DeadlineExceededError", "late"),
        ]
        async with running(ScriptedServing(*(reply(None, failure=fault) for fault in faults))) as pool:
            with caplog.at_level(logging.ERROR, "service.ray.pool"):
                with pytest.raises(WorkerError, match="by zero"):
                    await pool.localize(job())
                with pytest.raises(DeadlineExceededError, match="late"):
                    await pool.localize(job())

    run(scenario())
    (record,) = (each for each in caplog.records if each.name == "service.ray.pool")
    assert vars(record)["origin"] == "Traceback: here"


# Workers that die.


DEATHS = [ActorDiedError(), RayServeException("no replica")]


@pytest.mark.parametrize("death", DEATHS, ids=lambda death: type(death).__name__)
def test_a_query_whose_worker_died_is_given_to_another(death: Exception, caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        serving = ScriptedServing(
            reply(worker="one", resident_bytes=7), death, death, reply(worker="two", resident_bytes=5)
        )
        async with running(serving) as pool:
            await pool.localize(job())
            assert await pool.localize(job()) == OUTCOME
            assert len(serving.jobs) == 4
            assert pool.state().num_retries == 2
            assert pool.state().resident_bytes == 5  # nobody knows what the others held

    with caplog.at_level(logging.WARNING, "service.ray.pool"):
        run(scenario())
    told = [vars(each) for each in caplog.records if each.name == "service.ray.pool"]
    assert [(each["request_id"], each["attempt"], each["error"]) for each in told] == [
        ("req_1", 1, type(death).__name__),
        ("req_1", 2, type(death).__name__),
    ]


def test_a_query_that_kills_six_workers_is_given_up() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(*(ActorDiedError() for _ in range(6)), reply())
        async with running(serving) as pool:
            with pytest.raises(NoWorkerError, match="6 workers in a row were lost"):
                await pool.localize(job())
            assert (len(serving.jobs), pool.num_under_way) == (6, 0)
            assert await pool.localize(job()) == OUTCOME

    run(scenario())


def test_a_query_that_lost_several_workers_is_asked_alone() -> None:
    async def scenario() -> None:
        # The first loses three workers and is asked alone then, without a reply; only when it is gone the second is asked, and loses three.
        lost = [ActorDiedError() for _ in range(3)]
        serving = ScriptedServing(*lost, None, *lost, reply())
        async with running(serving) as pool:
            first, second = (asyncio.create_task(pool.localize(job(timeout_s=5.0))) for _ in range(2))
            while len(serving.jobs) < 4:
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.05)
            assert len(serving.jobs) == 4
            first.cancel()
            assert await second == OUTCOME
            assert len(serving.jobs) == 8

    run(scenario())


def test_others_wait_only_so_long_for_a_query_that_is_asked_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.ray.pool._LONGEST_ALONE_S", 0.1)

    async def scenario() -> None:
        serving = ScriptedServing(*(ActorDiedError() for _ in range(3)), None, reply())
        async with running(serving) as pool:
            first = asyncio.create_task(pool.localize(job(timeout_s=5.0)))
            while len(serving.jobs) < 4:
                await asyncio.sleep(0.01)
            began = time.monotonic()
            assert await pool.localize(job(timeout_s=5.0)) == OUTCOME
            assert 0.05 < time.monotonic() - began < 3
            assert not first.done()
            first.cancel()

    run(scenario())


def test_a_query_that_waits_to_be_asked_alone_ends_by_its_deadline() -> None:
    async def scenario() -> None:
        lost = [ActorDiedError() for _ in range(3)]
        quick = [reply(duration_s=0.001) for _ in range(20)]
        serving = ScriptedServing(*quick, *lost, None, reply())
        async with running(serving) as pool:
            for _ in quick:  # nobody expects those before to take long
                await pool.localize(job())
            first = asyncio.create_task(pool.localize(job(timeout_s=5.0)))
            second = asyncio.create_task(pool.localize(job(timeout_s=0.2)))
            with pytest.raises(DeadlineExceededError):
                await second
            first.cancel()
            assert await pool.localize(job()) == OUTCOME

    run(scenario())


def test_workers_are_handed_what_they_have_room_for_and_the_rest_as_it_came() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(*[None] * 5)
        async with running(serving, queue_limit=4) as pool:
            jobs = [job() for _ in range(5)]
            asked = [asyncio.create_task(pool.localize(each)) for each in jobs]
            await until(lambda: pool.num_under_way == 5)
            await asyncio.sleep(0.05)
            assert serving.jobs == jobs[:2]
            for number in range(3):
                asked[number].cancel()
                await until(lambda number=number: len(serving.jobs) == number + 3)
                assert serving.jobs == jobs[: number + 3]

    run(scenario())


def test_a_query_whose_worker_died_is_asked_again_before_those_that_came_later() -> None:
    async def scenario() -> None:
        death = asyncio.get_running_loop().create_future()
        serving = ScriptedServing(death, None, None, None)
        async with running(serving) as pool:
            jobs = [job() for _ in range(3)]
            tasks = [asyncio.create_task(pool.localize(each)) for each in jobs]
            await until(lambda: pool.num_under_way == 3)
            death.set_exception(ActorDiedError())
            await until(lambda: len(serving.jobs) == 3)
            await asyncio.sleep(0.05)
            assert serving.jobs == [jobs[0], jobs[1], jobs[0]]
            for task in tasks:
                task.cancel()

    run(scenario())


def test_a_query_whose_index_was_missing_is_asked_again_before_those_that_came_later() -> None:
    async def scenario() -> None:
        lacking = asyncio.get_running_loop().create_future()
        serving = ScriptedServing(lacking, None, None, None, None)
        serving.tasks = [reply()]
        async with running(serving) as pool:
            jobs = [job() for _ in range(4)]
            tasks = [asyncio.create_task(pool.localize(each)) for each in jobs]
            await until(lambda: pool.num_under_way == 4)
            lacking.set_result(missing(MAP))
            await until(lambda: len(serving.submitted) == 1 and len(serving.jobs) == 3)
            await asyncio.sleep(0.05)
            tasks[1].cancel()
            await until(lambda: len(serving.jobs) == 4)
            # The third had the place while the index was built.
            assert serving.jobs == [*jobs[:3], jobs[0]]
            for task in tasks:
                task.cancel()

    run(scenario())


def test_a_fault_in_our_own_code_is_not_tried_on_another_worker() -> None:
    async def scenario() -> None:
        fault = RayTaskError("localize", "Traceback", ZeroDivisionError())
        serving = ScriptedServing(fault, reply())
        async with running(serving) as pool:
            with pytest.raises(RayTaskError):
                await pool.localize(job())
            assert (len(serving.jobs), pool.state().num_retries) == (1, 0)

    run(scenario())


# Deadlines and callers who go away.


def test_a_query_past_its_deadline_is_withdrawn() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(None)
        async with running(serving) as pool:
            began = time.monotonic()
            with pytest.raises(DeadlineExceededError, match="timeout_s"):
                await pool.localize(job(timeout_s=0.1))
            assert 0.05 < time.monotonic() - began < 5
            assert serving.given[0].is_cancelled
            assert pool.num_under_way == 0

    run(scenario())


def test_a_query_whose_deadline_has_passed_is_not_waited_for() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(None)
        async with running(serving) as pool:
            with pytest.raises(DeadlineExceededError):
                await pool.localize(job(timeout_s=-5))

    run(scenario())


def test_a_caller_who_goes_away_takes_the_query_along() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(None)
        async with running(serving) as pool:
            asking = asyncio.create_task(pool.localize(job()))
            await until(lambda: serving.given)
            asking.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asking
            assert serving.given[0].is_cancelled
            assert pool.num_under_way == 0

    run(scenario())


# Lost indexes.


def test_an_index_that_is_missing_is_built_and_the_query_asked_again() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(missing(MAP, OTHER), reply())
        serving.tasks = [WorkerReply(), WorkerReply()]
        async with running(serving) as pool:
            assert await pool.localize(job(maps=(MAP, OTHER))) == OUTCOME
            assert serving.submitted == [("rebuild_map", MAP), ("rebuild_map", OTHER)]

    run(scenario())


def test_an_index_that_does_not_stay_is_built_twice_and_no_more() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(*(missing(MAP) for _ in range(5)))
        serving.tasks = [WorkerReply() for _ in range(5)]
        async with running(serving) as pool:
            with pytest.raises(NoWorkerError, match="map_a does not stay in Redis"):
                await pool.localize(job())
            assert len(serving.jobs) == 3
            assert pool.num_under_way == 0

    run(scenario())


def test_a_query_waits_for_a_missing_index_no_longer_than_its_deadline(ended_tasks: list[Any]) -> None:
    async def scenario() -> None:
        serving = ScriptedServing(missing(MAP))
        serving.tasks = [None]
        async with running(serving) as pool:
            with pytest.raises(DeadlineExceededError):
                await pool.localize(job(timeout_s=0.1))
            assert ended_tasks == []  # others may wait for it
        assert ended_tasks == serving.references

    run(scenario())


# Registrations.


def test_a_registration_is_a_task_of_its_own() -> None:
    async def scenario() -> None:
        outcome = RegisterOutcome({"num_points": 1}, [], b"")
        serving = ScriptedServing()
        serving.tasks = [reply(outcome), reply(None, failure=WorkerFailure("MemoryError", "too large"))]
        async with running(serving) as pool:
            assert await pool.register(registration()) == outcome
            with pytest.raises(WorkerError, match="too large"):
                await pool.register(registration())
            assert serving.submitted == [("register_map", registration())] * 2

    run(scenario())


def test_as_many_scans_are_read_at_the_same_time_as_the_operator_allows() -> None:
    async def scenario() -> None:
        serving = ScriptedServing()
        serving.tasks = [None] * 5
        pool = RayPool(cast(Any, ScriptedCluster()), cast(Any, serving), Admission(1), num_registrations=2)
        await pool.start()
        await until(lambda: pool.state().ready)
        waiting = [asyncio.create_task(pool.register(registration())) for _ in range(3)]
        await until(lambda: len(serving.submitted) == 2)
        await asyncio.sleep(0.05)
        assert len(serving.submitted) == 2
        for each in waiting:
            each.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)
        await pool.stop(drain_s=0)

    run(scenario())


# The queue.


def test_as_many_queries_wait_as_may_beyond_one_for_each_worker() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(*[None] * 9, num_workers=2)
        async with running(serving, queue_limit=1) as pool:
            asking = [asyncio.create_task(pool.localize(job())) for _ in range(3)]
            await until(lambda: pool.num_under_way == 3)
            assert pool.state().queue_depth == 1
            with pytest.raises(QueueFullError):
                await pool.localize(job())
            with pytest.raises(QueueFullError):
                pool.require_place(600)
            asking.pop().cancel()
            await until(lambda: pool.num_under_way == 2)
            pool.require_place(600)
            for each in asking:
                each.cancel()
            await asyncio.gather(*asking, return_exceptions=True)

    run(scenario())


def test_a_pool_that_takes_nothing_more_says_that_and_not_that_its_queue_is_full() -> None:
    async def scenario() -> None:
        async with running(ScriptedServing(*[None] * 9), queue_limit=0) as pool:
            asking = asyncio.create_task(pool.localize(job()))
            await until(lambda: pool.num_under_way == 1)
            with pytest.raises(QueueFullError):
                pool.require_place(600)
            pool.begin_drain()
            pool.require_place(600)
            with pytest.raises(NoWorkerError):
                await pool.localize(job())
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)

    run(scenario())


def test_how_long_workers_take_says_when_to_come_back() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(*(reply(duration_s=40.0) for _ in range(30)), None)
        pool = RayPool(cast(Any, ScriptedCluster()), cast(Any, serving), admission := Admission(0))
        await pool.start()
        await until(lambda: pool.state().ready)
        for _ in range(30):
            await pool.localize(job())
        asking = asyncio.create_task(pool.localize(job()))
        await until(lambda: pool.num_under_way == 1)
        assert 38 <= admission.retry_after_s <= 40
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)
        await pool.stop(drain_s=0)

    run(scenario())


# Beginning and end.


def test_before_there_are_workers_callers_are_told_what_is_waited_for() -> None:
    async def scenario() -> None:
        pool = RayPool(cast(Any, ScriptedCluster()), cast(Any, ScriptedServing()), Admission(3))
        assert not pool.state().ready
        for call in (pool.localize(job()), pool.register(registration())):
            with pytest.raises(NoWorkerError, match="waiting for the worker pool"):
                await call
        await pool.stop(drain_s=0)

    run(scenario())


def test_on_the_way_up_a_pool_says_how_far_it_has_come() -> None:
    async def scenario() -> None:
        may_connect, may_deploy = threading.Event(), threading.Event()
        cluster, serving = ScriptedCluster(), ScriptedServing()
        connect, deploy = cluster.connect, serving.deploy
        cluster.connect = lambda: (may_connect.wait(10), connect())[1]  # type: ignore[method-assign]
        serving.deploy = lambda: (may_deploy.wait(10), deploy())[1]  # type: ignore[method-assign]
        pool = RayPool(cast(Any, cluster), cast(Any, serving), Admission(3))
        await pool.start()
        await until(lambda: pool.state().waiting_for == "Ray")
        may_connect.set()
        await until(lambda: pool.state().waiting_for == "workers")
        assert not pool.state().ready
        may_deploy.set()
        await until(lambda: pool.state().ready)
        await pool.stop(drain_s=0)

    run(scenario())


def test_a_pool_whose_workers_are_not_up_yet_is_not_ready() -> None:
    async def scenario() -> None:
        serving = ScriptedServing(reply())
        serving.running = lambda: 0
        pool = RayPool(cast(Any, ScriptedCluster()), cast(Any, serving), Admission(3))
        await pool.start()
        serving.told = "no machine has a GPU to give"
        await until(lambda: pool.state().waiting_for == "workers (no machine has a GPU to give)")
        await asyncio.sleep(0.02)
        assert not pool.state().ready
        assert await pool.localize(job()) == OUTCOME  # it waits in Serve's queue instead
        await pool.stop(drain_s=0)

    run(scenario())


@pytest.mark.parametrize("fault", ["connect", "unreachable", "running"])
def test_a_pool_that_does_not_come_up_says_why_and_begins_again(
    fault: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(upkeep_module, "_RESTART_PAUSE_S", 0.2)
    monkeypatch.setattr(upkeep_module, "_WATCH_PERIOD_S", 0.02)

    async def scenario() -> None:
        cluster, serving = ScriptedCluster(), ScriptedServing(num_workers=2)
        if fault == "connect":
            cluster.failures = [ConnectionError("machine b: no Redis")]
        if fault == "unreachable":
            serving.faults = [["machine b: no Redis", "machine c: no files"]]
        pool = RayPool(cast(Any, cluster), cast(Any, serving), Admission(3))
        await pool.start()
        if fault == "running":
            await until(lambda: pool.state().ready)
            counts = iter([RuntimeError("machine b: no Redis")])

            def fail_once() -> int:
                for error in counts:
                    raise error
                return 2

            serving.running = fail_once
        await until(lambda: "machine b: no Redis" in (pool.state().waiting_for or ""))
        if fault == "unreachable":
            assert "; machine c: no files" in (pool.state().waiting_for or "")
        assert pool.state().num_workers == 0
        with pytest.raises(NoWorkerError, match="machine b: no Redis"):
            await pool.localize(job())
        await until(lambda: pool.state().ready)
        tried_before = ["rehearse"] if fault == "connect" else []
        assert cluster.asked == ["connect", "disconnect", *tried_before, "connect"]
        assert pool.state().num_workers == 2
        await pool.stop(drain_s=0)

    with caplog.at_level(logging.WARNING, "service.ray.upkeep"):
        run(scenario())
    (told,) = (vars(each) for each in caplog.records if each.name == "service.ray.upkeep")
    assert told["error"].startswith("machine b: no Redis")


@pytest.mark.slow
def test_the_log_says_once_that_the_workers_are_ready(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        serving = ScriptedServing(reply(), num_workers=2)
        async with running(serving) as pool:
            await asyncio.sleep(1.2)  # another look
            assert await pool.localize(job()) == OUTCOME

    with caplog.at_level(logging.INFO, "service.ray.upkeep"):
        run(scenario())
    (told,) = (vars(each) for each in caplog.records if "ready" in each.getMessage())
    assert told["workers"] == 2


@pytest.mark.parametrize(("error", "is_traced"), [(RayStartError("no room"), False), (ValueError("a fault"), True)])
def test_the_log_traces_faults_but_not_a_ray_that_does_not_start(
    error: Exception, is_traced: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        pool = RayPool(cast(Any, ScriptedCluster(error)), cast(Any, ScriptedServing()), Admission(3))
        await pool.start()
        await until(lambda: str(error) in (pool.state().waiting_for or ""))
        await pool.stop(drain_s=0)

    with caplog.at_level(logging.WARNING, "service.ray.upkeep"):
        run(scenario())
    assert [bool(each.exc_info) for each in caplog.records if each.name == "service.ray.upkeep"] == [is_traced]


def test_after_a_start_that_failed_ray_is_tried_elsewhere_until_it_starts_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(upkeep_module, "_RESTART_PAUSE_S", 0.01)

    async def scenario() -> None:
        cluster = ScriptedCluster(TimeoutError("the node timed out"))
        cluster.failed_rehearsals = [RuntimeError("Ray does not start: no room")] * 2
        pool = RayPool(cast(Any, cluster), cast(Any, ScriptedServing()), Admission(3))
        await pool.start()
        await until(lambda: "no room" in (pool.state().waiting_for or ""))
        await until(lambda: pool.state().ready)
        tries = [asked for asked in cluster.asked if asked != "disconnect"]
        assert tries == ["connect", "rehearse", "rehearse", "rehearse", "connect"]
        await pool.stop(drain_s=0)

    run(scenario())


def test_ray_is_only_ever_asked_in_one_thread() -> None:
    async def scenario() -> None:
        cluster = ScriptedCluster()
        pool = RayPool(cast(Any, cluster), cast(Any, ScriptedServing()), Admission(3))
        await pool.start()
        await until(lambda: pool.state().ready)
        await pool.stop(drain_s=0)
        assert cluster.asked == ["connect", "disconnect"]
        assert len(cluster.threads) == 1
        assert cluster.threads.pop().startswith("ray")

    run(scenario())


def test_at_the_end_what_is_under_way_goes_on_and_nothing_more_is_taken() -> None:
    async def scenario() -> None:
        cluster, serving = ScriptedCluster(), ScriptedServing(None)
        pool = RayPool(cast(Any, cluster), cast(Any, serving), Admission(3))
        await pool.start()
        await until(lambda: pool.state().ready)
        asking = asyncio.create_task(pool.localize(job(timeout_s=0.3)))
        await until(lambda: pool.num_under_way == 1)
        stopping = asyncio.create_task(pool.stop(drain_s=10))
        await asyncio.sleep(0.05)
        assert pool.state().waiting_for == "its end: the service is shutting down"
        for call in (pool.localize(job()), pool.register(registration())):
            with pytest.raises(NoWorkerError, match="shutting down"):
                await call
        assert cluster.asked == ["connect"]
        with pytest.raises(DeadlineExceededError):
            await asking
        await asyncio.wait_for(stopping, 5)
        assert serving.asked[-1] == "retire"
        assert cluster.asked == ["connect", "disconnect"]

    run(scenario())


def test_the_end_waits_no_longer_than_it_was_told_to() -> None:
    async def scenario() -> None:
        pool = RayPool(cast(Any, ScriptedCluster()), cast(Any, ScriptedServing(None)), Admission(3))
        await pool.start()
        await until(lambda: pool.state().ready)
        asking = asyncio.create_task(pool.localize(job()))
        await until(lambda: pool.num_under_way == 1)
        began = time.monotonic()
        await pool.stop(drain_s=0.2)
        assert 0.15 < time.monotonic() - began < 5
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)

    run(scenario())


def test_the_end_does_not_wait_for_a_ray_that_does_not_end(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(upkeep_module, "_LEAVE_S", 0.1)

    async def scenario() -> None:
        cluster = ScriptedCluster()
        monkeypatch.setattr(cluster, "disconnect", lambda: time.sleep(1.0))
        pool = RayPool(cast(Any, cluster), cast(Any, ScriptedServing()), Admission(3))
        await pool.start()
        await until(lambda: pool.state().ready)
        began = time.monotonic()
        await pool.stop(drain_s=0)
        assert time.monotonic() - began < 0.8

    with caplog.at_level(logging.WARNING, "service.ray.upkeep"):
        run(scenario())
    assert "Ray does not end" in caplog.text
