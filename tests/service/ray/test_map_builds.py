"""Registrations take turns; a lost index is built once for all who wait for it. No real Ray."""

import asyncio
from collections.abc import Coroutine
from typing import Any, cast

import pytest
from ray.exceptions import LocalRayletDiedError, NodeDiedError, OutOfMemoryError, WorkerCrashedError

from service.errors import NoWorkerError, RegistrationLimitError, TryAgainError, WorkerError
from service.jobs import MapRef, RegisterJob, RegisterOptions, RegisterOutcome
from service.ray.map_builds import MapBuilds
from service.worker.reply import WorkerFailure, WorkerReply

MAP, OTHER = MapRef("map_a", 1), MapRef("map_b", 1)


class Tasks:
    """Starts tasks that end when they are told to; notes their names and arguments in the order of their start."""

    def __init__(self) -> None:
        self.started: list[tuple[str, Any]] = []
        self.ends: list[asyncio.Future[Any]] = []
        self.cancelled: list[Any] = []
        self.gate = asyncio.Event()
        self.gate.set()

    async def submit(self, task: Any, argument: Any) -> Any:
        await self.gate.wait()
        self.started.append((task.__name__, argument.scan_name if isinstance(argument, RegisterJob) else argument))
        self.ends.append(asyncio.get_running_loop().create_future())
        return self.ends[-1]

    def end(self, number: int, result: Any = None) -> None:
        """Let a task end with a reply or an exception."""
        if isinstance(result, BaseException):
            self.ends[number].set_exception(result)
        else:
            self.ends[number].set_result(result or WorkerReply())


@pytest.fixture
def tasks(monkeypatch: pytest.MonkeyPatch) -> Tasks:
    tasks = Tasks()

    def cancel(reference: Any, *, force: bool) -> None:
        assert force
        tasks.cancelled.append(reference)

    monkeypatch.setattr("ray.cancel", cancel)
    return tasks


def job(name: str, time_limit_s: float | None = None) -> RegisterJob:
    return RegisterJob(MAP, "key", name, RegisterOptions(), "req_1", time_limit_s)


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(scenario, 10))


@pytest.mark.parametrize("num_registrations", [1, 2])
def test_so_many_registrations_run_at_the_same_time_and_the_others_in_turn(
    tasks: Tasks, num_registrations: int
) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, num_registrations)
        names = ["one", "two", "three", "four"]
        running = [asyncio.create_task(builds.register(job(name))) for name in names]
        await settled()
        assert tasks.started == [("register_map", name) for name in names[:num_registrations]]
        for number in range(4):
            tasks.end(number, WorkerReply(RegisterOutcome({"name": names[number]}, [], b"")))
            await settled()
        replies = await asyncio.gather(*running)
        assert [cast(Any, reply.outcome).stats["name"] for reply in replies] == names

    run(scenario())


def test_a_registration_that_takes_too_long_is_ended_and_gives_its_place_to_the_next(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        first = asyncio.create_task(builds.register(job("slow", time_limit_s=0.05)))
        await settled()
        second = asyncio.create_task(builds.register(job("next", time_limit_s=0.05)))
        with pytest.raises(RegistrationLimitError, match="expected a map within"):
            await first
        assert tasks.cancelled == [tasks.ends[0]]
        await settled()
        tasks.end(1)
        await second

    run(scenario())


def test_a_registration_says_when_its_turn_has_come_and_may_be_refused_then(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds, turns = MapBuilds(tasks.submit, 1), []

        async def begin() -> None:
            turns.append(list(tasks.started))

        async def refuse() -> None:
            raise TryAgainError("not now")

        first, second = (asyncio.create_task(builds.register(job(name), begin)) for name in ("one", "two"))
        await settled()
        assert turns == [[]]
        tasks.end(0)
        await settled()
        assert turns == [[], [("register_map", "one")]]
        third = asyncio.create_task(builds.register(job("three"), refuse))
        tasks.end(1)
        await asyncio.gather(first, second)
        with pytest.raises(TryAgainError):
            await third
        assert len(tasks.started) == 2

    run(scenario())


def test_an_index_is_built_once_for_all_who_wait_and_anew_for_those_who_come_later(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        waiting = [asyncio.create_task(builds.rebuild([MAP])) for _ in range(3)]
        await settled()
        assert tasks.started == [("rebuild_map", MAP)]
        tasks.end(0)
        await asyncio.gather(*waiting)
        again = asyncio.create_task(builds.rebuild([MAP]))
        await settled()
        assert tasks.started == [("rebuild_map", MAP)] * 2
        tasks.end(1)
        await again

    run(scenario())


def test_indexes_are_built_one_after_the_other_and_all_are_waited_for(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 5)
        waiting = asyncio.create_task(builds.rebuild([MAP, OTHER]))
        await settled()
        assert tasks.started == [("rebuild_map", MAP)]
        tasks.end(0)
        await settled()
        assert tasks.started == [("rebuild_map", MAP), ("rebuild_map", OTHER)]
        assert not waiting.done()
        tasks.end(1)
        await waiting

    run(scenario())


def test_a_query_that_waits_for_an_index_does_not_wait_for_somebodys_scan(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        registering = asyncio.create_task(builds.register(job("large")))
        waiting = asyncio.create_task(builds.rebuild([MAP]))
        await settled()
        assert [name for name, _ in tasks.started] == ["register_map", "rebuild_map"]
        tasks.end(1)
        await waiting
        assert not registering.done()
        tasks.end(0)
        await registering

    run(scenario())


def test_what_the_worker_raised_reaches_all_who_wait(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        waiting = [asyncio.create_task(builds.rebuild([MAP])) for _ in range(2)]
        await settled()
        tasks.end(0, WorkerReply(failure=WorkerFailure("ValueError", "no such scan")))
        for each in waiting:
            with pytest.raises(WorkerError, match="no such scan"):
                await each

    run(scenario())


def test_a_build_goes_on_when_the_query_that_asked_for_it_gives_up(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        first, second = (asyncio.create_task(builds.rebuild([MAP])) for _ in range(2))
        await settled()
        first.cancel()
        await asyncio.gather(first, return_exceptions=True)
        assert tasks.cancelled == []
        tasks.end(0)
        await second
        assert len(tasks.started) == 1

    run(scenario())


def test_a_registration_that_nobody_waits_for_is_ended_and_gives_its_place_to_the_next(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        first, second = (asyncio.create_task(builds.register(job(name))) for name in ("one", "two"))
        await settled()
        first.cancel()
        with pytest.raises(asyncio.CancelledError):
            await first
        assert tasks.cancelled == [tasks.ends[0]]
        await settled()
        assert [name for _, name in tasks.started] == ["one", "two"]
        tasks.end(1)
        await second

    run(scenario())


def test_a_registration_that_is_given_up_while_it_is_handed_over_is_ended_as_soon_as_it_exists(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        tasks.gate.clear()
        given_up = [asyncio.create_task(builds.register(job(name))) for name in ("one", "two")]
        for each in given_up:
            await settled()
            each.cancel()
            with pytest.raises(asyncio.CancelledError):
                await each
        tasks.gate.set()
        await builds.cancel()
        assert [name for _, name in tasks.started] == ["one", "two"]
        assert tasks.cancelled == tasks.ends

    run(scenario())


def test_a_registration_that_is_given_up_while_ray_refuses_it_leaves_nothing_to_end(tasks: Tasks) -> None:
    async def scenario() -> None:
        refused = asyncio.Event()

        async def submit(task: Any, argument: Any) -> Any:
            await refused.wait()
            raise RuntimeError("no cluster")

        builds = MapBuilds(submit, 1)
        waiting = asyncio.create_task(builds.register(job("one")))
        await settled()
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        refused.set()
        await builds.cancel()
        assert tasks.cancelled == []

    run(scenario())


def test_at_the_end_the_builds_under_way_are_ended(tasks: Tasks) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        waiting = asyncio.create_task(builds.rebuild([MAP, OTHER]))
        await settled()
        await builds.cancel()
        assert tasks.cancelled == [tasks.ends[0]]
        assert len(tasks.started) == 1
        with pytest.raises(asyncio.CancelledError):
            await waiting
        await builds.cancel()  # nothing is left to end

    run(scenario())


@pytest.mark.parametrize(
    ("death", "said"),
    [
        (WorkerCrashedError(), "WorkerCrashedError.*too little memory for this scan"),
        (OutOfMemoryError("full"), "OutOfMemoryError.*too little memory for this scan"),
        (LocalRayletDiedError(), r"the machine's Ray ended while it built the map \(LocalRayletDiedError\)"),
        (NodeDiedError("gone"), r"the machine's Ray ended while it built the map \(NodeDiedError\)"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)
def test_a_process_that_dies_is_told_from_a_machine_that_does(tasks: Tasks, death: Exception, said: str) -> None:
    async def scenario() -> None:
        builds = MapBuilds(tasks.submit, 1)
        for work in (builds.register(job("one")), builds.rebuild([MAP])):
            waiting = asyncio.ensure_future(work)
            await settled()
            tasks.end(len(tasks.ends) - 1, death)
            with pytest.raises(NoWorkerError, match=said):
                await waiting

    run(scenario())
