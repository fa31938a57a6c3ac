"""Registrations wait for each other; a lost index is built once for all who wait for it. Builds are scripted here."""

import asyncio
from typing import Any, cast

import pytest

from panoloc.service.errors import NoWorkerError, RegistrationLimitError, TryAgainError, WorkerError
from panoloc.service.jobs import MapRef, RegisterJob, RegisterOptions, RegisterOutcome
from panoloc.service.pool.forked_process import ForkServer
from panoloc.service.pool.map_builds import MapBuilds
from panoloc.service.pool.worker_process import run_build
from panoloc.service.worker.plan import WorkerFailure, WorkerPlan, WorkerReply

pytestmark = pytest.mark.anyio

MAP, OTHER = MapRef("map_a", 1), MapRef("map_b", 1)


class Builds(MapBuilds):
    """Builds end when they are told to; notes what was started and what was cancelled."""

    def __init__(self, num_registrations: int = 1) -> None:
        super().__init__(self.build, num_registrations)
        self.started: list[Any] = []
        self.ends: list[asyncio.Future[WorkerReply[Any]]] = []
        self.cancelled: list[Any] = []

    async def build(self, subject: Any) -> WorkerReply[Any]:
        self.started.append(subject.scan_name if isinstance(subject, RegisterJob) else subject)
        self.ends.append(asyncio.get_running_loop().create_future())
        try:
            return await self.ends[-1]
        except asyncio.CancelledError:
            self.cancelled.append(self.started[-1])
            raise

    async def end(self, number: int, reply: WorkerReply[Any] | None = None) -> None:
        self.ends[number].set_result(reply or WorkerReply())
        await settled()


def job(name: str, time_limit_s: float | None = None) -> RegisterJob:
    return RegisterJob(MAP, "key", name, RegisterOptions(), "req_1", time_limit_s)


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


@pytest.mark.parametrize("num_registrations", [1, 2])
async def test_so_many_registrations_run_at_the_same_time_and_the_others_in_turn(num_registrations: int) -> None:
    builds = Builds(num_registrations)
    names = ["one", "two", "three", "four"]
    running = [asyncio.create_task(builds.register(job(name))) for name in names]
    await settled()
    assert builds.started == names[:num_registrations]
    for number in range(4):
        await builds.end(number, WorkerReply(RegisterOutcome({"name": names[number]}, [], b"")))
    replies = await asyncio.gather(*running)
    assert [reply.outcome.stats["name"] for reply in replies if reply.outcome] == names


async def test_a_registration_that_takes_too_long_is_ended_and_gives_its_place_to_the_next() -> None:
    builds = Builds()
    first = asyncio.create_task(builds.register(job("slow", time_limit_s=0.05)))
    second = asyncio.create_task(builds.register(job("next", time_limit_s=5)))
    with pytest.raises(RegistrationLimitError, match="thin the scan"):
        await first
    assert builds.cancelled == ["slow"]
    await settled()
    await builds.end(1)
    await second


async def test_a_registration_is_announced_when_its_turn_has_come_and_may_be_refused_then() -> None:
    builds, turns = Builds(), []

    async def begin() -> None:
        turns.append(list(builds.started))

    async def refuse() -> None:
        raise TryAgainError("not now")

    first, second = (asyncio.create_task(builds.register(job(name), begin)) for name in ("one", "two"))
    await settled()
    assert turns == [[]]
    await builds.end(0)
    assert turns == [[], ["one"]]
    third = asyncio.create_task(builds.register(job("three"), refuse))
    await builds.end(1)
    await asyncio.gather(first, second)
    with pytest.raises(TryAgainError):
        await third
    assert builds.started == ["one", "two"]


async def test_a_timeout_inside_a_build_is_not_taken_for_the_limit_of_the_registration() -> None:
    async def build(subject: Any) -> WorkerReply[Any]:
        raise TimeoutError("of something else")

    with pytest.raises(TimeoutError, match="something else"):
        await MapBuilds(build, 1).register(job("one", time_limit_s=60))


async def test_queries_that_miss_the_same_index_wait_for_one_build_which_outlives_those_that_give_up() -> None:
    builds = Builds()
    waiting = [asyncio.create_task(builds.rebuild([MAP])) for _ in range(3)]
    await settled()
    waiting[0].cancel()
    await settled()
    assert (builds.started, builds.cancelled) == ([MAP], [])
    await builds.end(0)
    await asyncio.gather(*waiting[1:])
    again = asyncio.create_task(builds.rebuild([MAP]))  # lost once more
    await settled()
    assert builds.started == [MAP, MAP]
    await builds.end(1)
    await again


async def test_a_rebuild_does_not_wait_for_registrations_but_for_other_rebuilds() -> None:
    builds = Builds()
    registering = asyncio.create_task(builds.register(job("large")))
    rebuilding = asyncio.create_task(builds.rebuild([MAP, OTHER]))
    await settled()
    assert builds.started == ["large", MAP]
    await builds.end(1)
    assert builds.started == ["large", MAP, OTHER]
    await builds.end(2)
    await rebuilding
    await builds.end(0)
    await registering


async def test_what_a_rebuild_raised_in_its_worker_is_told_to_all_who_wait() -> None:
    builds = Builds()
    waiting = [asyncio.create_task(builds.rebuild([MAP])) for _ in range(2)]
    await settled()
    await builds.end(0, WorkerReply(failure=WorkerFailure("KeyError", "a fault")))
    for each in await asyncio.gather(*waiting):
        assert list(each) == [MAP]
        assert isinstance(each[MAP], WorkerError)
        assert "a fault" in str(each[MAP])


async def test_a_rebuild_whose_process_dies_is_begun_once_more() -> None:
    attempts = []

    async def build(subject: Any) -> WorkerReply[Any]:
        attempts.append(subject)
        raise NoWorkerError("killed")

    with pytest.raises(NoWorkerError, match="killed"):
        await MapBuilds(build, 1).rebuild([MAP])
    assert attempts == [MAP, MAP]


async def test_a_build_whose_process_cannot_start_fails_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(*_: object, **__: object) -> None:
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr(asyncio, "create_subprocess_exec", refuse)
    with pytest.raises(NoWorkerError, match=r"could not be started.*memory"):
        await run_build(cast(WorkerPlan, None), MAP, ForkServer([]))


async def test_the_end_ends_rebuilds_and_those_who_wait_for_them() -> None:
    builds = Builds()
    waiting = asyncio.create_task(builds.rebuild([MAP]))
    await settled()
    await builds.cancel()
    assert builds.cancelled == [MAP]
    with pytest.raises(asyncio.CancelledError):
        await waiting
