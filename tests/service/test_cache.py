"""What workers and the HTTP process keep in a real Redis, for how long, and what they are told while it is away."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import Any

import pytest
import redis
from redis.asyncio.connection import AbstractConnection

from panoloc.service.cache import Cache, WorkerCache
from panoloc.service.errors import CacheDownError
from panoloc.service.jobs import ARTIFACTS, MapRef

pytestmark = pytest.mark.anyio

REF, DIGEST = MapRef("map_a", 2), "0f"
OTHERS = ((MapRef("map_b", 2), DIGEST), (MapRef("map_a", 1), DIGEST), (REF, "1e"))
INDEX, PROGRESS = "index:map_a:2:0f", "progress:map_a:2"
NOWHERE = "unix:///nowhere/redis.sock"


def keys(client: "redis.Redis") -> set[str]:
    """Return the names of all that Redis holds."""
    return {str(key) for key in client.scan_iter()}


@pytest.fixture
def worker_cache(redis_url: str) -> Iterator[WorkerCache]:
    cache = WorkerCache(redis_url, index_lifetime_s=1000)
    yield cache
    cache.close()


@pytest.mark.parametrize("again", ["put", "get"])
def test_an_index_lives_for_its_whole_time_after_each_write_and_read(
    worker_cache: WorkerCache, redis_client: "redis.Redis", again: str
) -> None:
    worker_cache.put_index(REF, DIGEST, b"\x00index\xff")
    assert keys(redis_client) == {INDEX}
    assert 990 < int(redis_client.ttl(INDEX)) <= 1000
    redis_client.expire(INDEX, 5)
    if again == "put":
        worker_cache.put_index(REF, DIGEST, b"another")
    else:
        assert worker_cache.get_index(REF, DIGEST) == b"\x00index\xff"
    assert int(redis_client.ttl(INDEX)) > 990


def test_an_index_is_of_one_map_revision_and_configuration(
    worker_cache: WorkerCache, redis_client: "redis.Redis"
) -> None:
    worker_cache.put_index(REF, DIGEST, b"index")
    assert [worker_cache.get_index(*other) for other in OTHERS] == [None] * 3
    for other in OTHERS:
        worker_cache.put_index(*other, b"index")
    worker_cache.forget_index(REF, DIGEST)
    assert worker_cache.get_index(REF, DIGEST) is None
    assert len(keys(redis_client)) == 3


def test_progress_is_told_in_words_and_numbers_for_ten_minutes(
    worker_cache: WorkerCache, redis_client: "redis.Redis"
) -> None:
    worker_cache.report_progress(REF, "indexing", "rendering starts", 0.123456)
    found = {"status": "indexing", "stage": "rendering starts", "progress": 0.123}
    assert json.loads(str(redis_client.get(PROGRESS))) == found
    assert 590 < int(redis_client.ttl(PROGRESS)) <= 600


@pytest.mark.slow
def test_workers_are_told_when_redis_is_away() -> None:
    cache = WorkerCache(NOWHERE, index_lifetime_s=1000)
    calls: tuple[Callable[[], object], ...] = (
        lambda: cache.get_index(REF, DIGEST),
        lambda: cache.put_index(REF, DIGEST, b""),
        lambda: cache.forget_index(REF, DIGEST),
        lambda: cache.report_progress(REF, "reading", "", 0.0),
    )
    for call in calls:
        with pytest.raises(CacheDownError, match="expected an answer from Redis, got ConnectionError"):
            call()


@pytest.mark.parametrize(
    "fault", [redis.exceptions.OutOfMemoryError, redis.exceptions.ReadOnlyError, redis.exceptions.BusyLoadingError]
)
def test_a_redis_that_is_full_or_read_only_is_as_good_as_away(
    worker_cache: WorkerCache, fault: type[Exception]
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise fault("not now")

    worker_cache._redis.set = refuse  # type: ignore[method-assign]
    with pytest.raises(CacheDownError, match=f"got {fault.__name__}"):
        worker_cache.put_index(REF, DIGEST, b"")


def test_an_index_is_read_from_a_redis_that_is_read_only(
    worker_cache: WorkerCache, redis_client: "redis.Redis"
) -> None:
    worker_cache.put_index(REF, DIGEST, b"index")
    redis_client.replicaof("127.0.0.1", "1")
    try:
        assert worker_cache.get_index(REF, DIGEST) == b"index"
    finally:
        redis_client.replicaof("NO", "ONE")


def test_a_fault_that_does_not_pass_by_itself_is_not_called_away(
    worker_cache: WorkerCache, redis_client: "redis.Redis"
) -> None:
    redis_client.lpush(INDEX, "not what we keep there")
    with pytest.raises(redis.ResponseError):
        worker_cache.get_index(REF, DIGEST)


# The side of the HTTP process.

BODY = {"status": "localized", "confidence": 0.5}
PICTURES: dict[str, bytes] = {name: f"a {name}".encode() for name in ARTIFACTS}


@pytest.fixture
async def cache(redis_url: str, anyio_backend: str) -> AsyncIterator[Cache]:
    """Answers live for 500 s."""
    cache = Cache(redis_url, result_lifetime_s=500)
    yield cache
    await cache.close()


async def test_an_answer_is_read_back_with_its_pictures(cache: Cache, redis_client: "redis.Redis") -> None:
    await cache.put_answer("loc_1", BODY, PICTURES, ["map_a", "map_b"])
    assert await cache.get_localization("loc_1") == BODY
    assert {name: await cache.get_picture("loc_1", name) for name in PICTURES} == PICTURES
    assert await cache.get_localization("loc_2") is None
    assert await cache.get_picture("loc_1", "another") is None
    assert await cache.get_picture("loc_2", ARTIFACTS[0]) is None
    assert len(keys(redis_client)) == 1 + len(PICTURES) + 2
    assert all(490 < int(redis_client.ttl(key)) <= 500 for key in keys(redis_client))


async def test_a_state_lives_as_long_as_an_answer_and_the_query_before_it(
    cache: Cache, redis_client: "redis.Redis"
) -> None:
    await cache.put_state("loc_1", {"status": "running"})
    await cache.put_state("loc_2", {"status": "running"}, extra_s=60.5)
    assert await cache.get_localization("loc_2") == {"status": "running"}
    assert 490 < int(redis_client.ttl("localization:loc_1")) <= 500
    assert 550 < int(redis_client.ttl("localization:loc_2")) <= 560


async def test_no_answer_holds_what_json_does_not_have(cache: Cache, redis_client: "redis.Redis") -> None:
    with pytest.raises(ValueError):
        await cache.put_answer("loc_1", {"confidence": float("nan")}, {}, [])
    assert keys(redis_client) == set()


async def test_a_map_s_list_of_answers_forgets_those_that_have_expired(
    cache: Cache, redis_client: "redis.Redis"
) -> None:
    redis_client.zadd("of_map:map_a", {"loc_old": time.time() - 1, "loc_new": time.time() + 50})
    redis_client.expire("of_map:map_a", 50)
    await cache.put_answer("loc_1", BODY, {}, ["map_a"])
    found: Any = redis_client.zrange("of_map:map_a", 0, -1, withscores=True)
    assert [name for name, _ in found] == ["loc_new", "loc_1"]
    assert 490 < found[1][1] - time.time() <= 500
    assert 490 < int(redis_client.ttl("of_map:map_a")) <= 500


async def test_progress_is_told_of_the_revisions_that_have_begun(cache: Cache, worker_cache: WorkerCache) -> None:
    worker_cache.report_progress(REF, "reading", "reading the scan", 0.5)
    found = {REF: {"status": "reading", "stage": "reading the scan", "progress": 0.5}}
    assert await cache.get_progress([MapRef("map_b", 1), REF]) == found
    assert await cache.get_progress([]) == {}


async def test_a_revision_is_forgotten_alone(
    cache: Cache, worker_cache: WorkerCache, redis_client: "redis.Redis"
) -> None:
    for ref in (REF, MapRef("map_a", 22), MapRef("map_a", 1), MapRef("map_b", 2)):
        for digest in (DIGEST, "1e"):
            worker_cache.put_index(ref, digest, b"index")
        worker_cache.report_progress(ref, "reading", "", 0.0)
    await cache.forget_revision(REF)
    assert keys(redis_client) == {
        f"{what}:{ref}{digest}"
        for ref in ("map_a:22", "map_a:1", "map_b:2")
        for what, digest in (("index", ":0f"), ("index", ":1e"), ("progress", ""))
    }


async def test_a_map_is_forgotten_with_its_answers_and_nothing_of_others(
    cache: Cache, worker_cache: WorkerCache, redis_client: "redis.Redis"
) -> None:
    for ref in (REF, MapRef("map_a", 1), MapRef("map_b", 2)):
        worker_cache.put_index(ref, DIGEST, b"index")
        worker_cache.report_progress(ref, "reading", "", 0.0)
    await cache.put_answer("loc_1", BODY, PICTURES, ["map_a"])
    await cache.put_answer("loc_2", BODY, PICTURES, ["map_b"])
    await cache.forget_map("map_a")
    await cache.forget_map("map_unknown")
    of_others = {"index:map_b:2:0f", "progress:map_b:2", "of_map:map_b", "localization:loc_2"}
    assert keys(redis_client) == of_others | {f"picture:loc_2:{name}" for name in ARTIFACTS}


@pytest.mark.slow
async def test_the_http_process_is_told_when_redis_is_away() -> None:
    cache = Cache(NOWHERE, result_lifetime_s=500)
    calls: tuple[Callable[[], Awaitable[object]], ...] = (
        lambda: cache.check(),
        lambda: cache.get_progress([REF]),
        lambda: cache.put_state("loc_1", {}),
        lambda: cache.put_answer("loc_1", {}, {}, []),
        lambda: cache.get_localization("loc_1"),
        lambda: cache.get_picture("loc_1", "overlay"),
        lambda: cache.forget_revision(REF),
        lambda: cache.forget_map("map_a"),
    )
    for call in calls:
        with pytest.raises(CacheDownError, match="expected an answer from Redis, got ConnectionError") as told:
            await call()
        assert told.value.retry_after_s == 2


@pytest.mark.slow
async def test_a_redis_that_hangs_is_said_to_be_away_before_those_give_up_who_ask() -> None:
    async def hang(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await gone.wait()
        writer.close()

    gone = asyncio.Event()
    server = await asyncio.start_server(hang, "127.0.0.1", 0)
    cache = Cache(f"redis://127.0.0.1:{server.sockets[0].getsockname()[1]}", result_lifetime_s=500)
    with pytest.raises(CacheDownError, match="expected an answer from Redis, got TimeoutError"):
        async with asyncio.timeout(5.0):
            await cache.check_writable()
    gone.set()
    await cache.close()
    server.close()


async def test_a_redis_that_was_away_for_a_moment_is_asked_again(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    send, num_failures = AbstractConnection.send_packed_command, 2

    async def failing(connection: AbstractConnection, *arguments: object, **options: object) -> None:
        nonlocal num_failures
        if num_failures:
            num_failures -= 1
            raise redis.ConnectionError("gone for a moment")
        await send(connection, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(AbstractConnection, "send_packed_command", failing)
    await cache.check()
    assert num_failures == 0


async def test_whoever_goes_away_just_when_redis_answers_has_gone_away(cache: Cache) -> None:
    task = asyncio.current_task()
    assert task is not None

    async def swallowing(*_: object, **__: object) -> None:
        task.cancel()
        try:
            await asyncio.sleep(0)
        except asyncio.CancelledError:
            return  # as redis-py does in Python 3.11

    cache._redis.ping = swallowing  # type: ignore[method-assign, assignment]
    with pytest.raises(asyncio.CancelledError):
        await cache.check()
    task.uncancel()


async def test_the_look_whether_redis_takes_values_says_so_and_leaves_no_key(
    cache: Cache, redis_client: "redis.Redis"
) -> None:
    await cache.check_writable()
    assert keys(redis_client) == set()
    former: Any = redis_client.config_get("maxmemory*")
    redis_client.config_set("maxmemory", 1)
    redis_client.config_set("maxmemory-policy", "noeviction")
    try:
        with pytest.raises(CacheDownError, match="OutOfMemoryError"):
            await cache.check_writable()
    finally:
        for name in ("maxmemory", "maxmemory-policy"):
            redis_client.config_set(name, former[name])
