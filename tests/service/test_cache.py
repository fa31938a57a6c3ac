"""What workers and the HTTP process keep in a real Redis, for how long, and what they are told while it is away."""

import asyncio
import itertools
import json
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import TypeVar

import pytest
import redis

from panoloc.service.cache import Cache, WorkerCache
from panoloc.service.errors import CacheDownError
from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.jobs import ARTIFACTS, MapRef

Result = TypeVar("Result")
REF, DIGEST = MapRef("map_a", 2), "0f"
INDEX, PROGRESS = "index:map_a:2:0f", "progress:map_a:2"


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    # pytest's own folders are too long for a socket.
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        server = EmbeddedRedis(Path(folder), max_memory_bytes=16 * 2**20)
        server.start()
        yield server.url
        server.stop()


@pytest.fixture
def client(url: str) -> Iterator["redis.Redis"]:
    with redis.Redis.from_url(url) as client:
        client.flushall()
        yield client


def keys(client: "redis.Redis") -> set[str]:
    """Return the names of all that Redis holds."""
    return {key.decode() for key in client.scan_iter() if isinstance(key, bytes)}


@pytest.fixture
def cache(url: str, client: "redis.Redis") -> Iterator[WorkerCache]:
    cache = WorkerCache(url, index_lifetime_s=1000, progress_lifetime_s=300)
    yield cache
    cache.close()


def test_an_index_is_read_back_and_lives_for_a_time(cache: WorkerCache, client: "redis.Redis") -> None:
    cache.put_index(REF, DIGEST, b"\x00index\xff")
    assert cache.get_index(REF, DIGEST) == b"\x00index\xff"
    assert keys(client) == {INDEX}
    assert 990 < int(client.ttl(INDEX)) <= 1000


def test_an_index_that_is_written_again_lives_for_its_whole_time(cache: WorkerCache, client: "redis.Redis") -> None:
    cache.put_index(REF, DIGEST, b"index")
    client.expire(INDEX, 5)
    cache.put_index(REF, DIGEST, b"another")
    assert int(client.ttl(INDEX)) > 990


def test_an_index_that_is_read_lives_for_its_whole_time_again(cache: WorkerCache, client: "redis.Redis") -> None:
    cache.put_index(REF, DIGEST, b"index")
    client.expire(INDEX, 5)
    assert cache.get_index(REF, DIGEST) == b"index"
    assert int(client.ttl(INDEX)) > 990


def test_an_index_is_another_one_for_another_map_revision_or_configuration(cache: WorkerCache) -> None:
    cache.put_index(REF, DIGEST, b"index")
    for ref, digest in ((MapRef("map_b", 2), DIGEST), (MapRef("map_a", 1), DIGEST), (REF, "1e")):
        assert cache.get_index(ref, digest) is None


def test_only_the_index_that_is_named_is_forgotten(cache: WorkerCache, client: "redis.Redis") -> None:
    for ref, digest in ((REF, DIGEST), (MapRef("map_b", 2), DIGEST), (MapRef("map_a", 1), DIGEST), (REF, "1e")):
        cache.put_index(ref, digest, b"index")
    cache.forget_index(REF, DIGEST)
    assert cache.get_index(REF, DIGEST) is None
    assert len(keys(client)) == 3


def test_progress_is_told_in_words_and_numbers_and_lives_for_a_time(cache: WorkerCache, client: "redis.Redis") -> None:
    cache.report_progress(REF, "indexing", "rendering starts", 0.123456)
    found = client.get(PROGRESS)
    assert isinstance(found, bytes)
    assert json.loads(found) == {"status": "indexing", "stage": "rendering starts", "progress": 0.123}
    assert 290 < int(client.ttl(PROGRESS)) <= 300


def test_progress_is_forgotten_after_ten_minutes_unless_told_otherwise(url: str, client: "redis.Redis") -> None:
    cache = WorkerCache(url, index_lifetime_s=1000)
    cache.report_progress(REF, "reading", "reading the scan", 0.0)
    cache.close()
    assert 590 < int(client.ttl(PROGRESS)) <= 600


@pytest.mark.slow
def test_workers_are_told_when_redis_is_away() -> None:
    cache = WorkerCache("unix:///nowhere/redis.sock", index_lifetime_s=1000)
    calls: tuple[Callable[[], object], ...] = (
        lambda: cache.get_index(REF, DIGEST),
        lambda: cache.put_index(REF, DIGEST, b""),
        lambda: cache.forget_index(REF, DIGEST),
        lambda: cache.report_progress(REF, "reading", "", 0.0),
    )
    for call in calls:
        with pytest.raises(CacheDownError, match="expected an answer from Redis, got ConnectionError") as told:
            call()
        assert told.value.retry_after_s >= 1


def test_a_redis_that_is_full_or_read_only_is_as_good_as_away(cache: WorkerCache, client: "redis.Redis") -> None:
    for fault in (redis.exceptions.OutOfMemoryError, redis.exceptions.ReadOnlyError, redis.exceptions.BusyLoadingError):

        def refuse(*_: object, error: type[Exception] = fault, **__: object) -> None:
            raise error("not now")

        cache._redis.set = refuse  # type: ignore[method-assign]
        with pytest.raises(CacheDownError, match=f"got {fault.__name__}"):
            cache.put_index(REF, DIGEST, b"")


def test_an_index_is_read_from_a_redis_that_is_read_only(cache: WorkerCache, client: "redis.Redis") -> None:
    cache.put_index(REF, DIGEST, b"index")
    client.replicaof("127.0.0.1", "1")
    try:
        assert cache.get_index(REF, DIGEST) == b"index"
    finally:
        client.replicaof("NO", "ONE")


def test_a_fault_that_does_not_pass_by_itself_is_not_called_away(cache: WorkerCache, client: "redis.Redis") -> None:
    client.lpush(INDEX, "not what we keep there")
    with pytest.raises(redis.ResponseError):
        cache.get_index(REF, DIGEST)


# The side of the HTTP process.


def ask(url: str, question: Callable[[Cache], Awaitable[Result]]) -> Result:
    """Ask a cache of its own, whose answers live for 500 s."""

    async def asked() -> Result:
        cache = Cache(url, result_lifetime_s=500)
        try:
            return await question(cache)
        finally:
            await cache.close()

    return asyncio.run(asked())


BODY = {"status": "localized", "confidence": 0.5}
PICTURES: dict[str, bytes] = {name: f"a {name}".encode() for name in ARTIFACTS}


def test_an_answer_is_read_back_with_its_pictures(url: str, client: "redis.Redis") -> None:
    async def scenario(cache: Cache) -> None:
        await cache.put_answer("loc_1", BODY, PICTURES, ["map_a", "map_b"])
        assert await cache.get_localization("loc_1") == BODY
        for name, data in PICTURES.items():
            assert await cache.get_picture("loc_1", name) == data
        assert await cache.get_localization("loc_2") is None
        assert await cache.get_picture("loc_1", "another") is None
        assert await cache.get_picture("loc_2", ARTIFACTS[0]) is None

    ask(url, scenario)
    assert len(keys(client)) == 1 + len(PICTURES) + 2
    assert all(490 < int(client.ttl(key)) <= 500 for key in keys(client))


def test_a_state_lives_as_long_as_an_answer_and_the_query_before_it(url: str, client: "redis.Redis") -> None:
    async def scenario(cache: Cache) -> None:
        await cache.put_state("loc_1", {"status": "running"})
        await cache.put_state("loc_2", {"status": "running"}, extra_s=60.5)
        assert await cache.get_localization("loc_2") == {"status": "running"}

    ask(url, scenario)
    assert 490 < int(client.ttl("localization:loc_1")) <= 500
    assert 550 < int(client.ttl("localization:loc_2")) <= 560


def test_no_answer_holds_what_json_does_not_have(url: str, client: "redis.Redis") -> None:
    with pytest.raises(ValueError):
        ask(url, lambda cache: cache.put_answer("loc_1", {"confidence": float("nan")}, {}, []))
    assert keys(client) == set()


def test_a_map_s_list_of_answers_forgets_those_that_have_expired(url: str, client: "redis.Redis") -> None:
    client.zadd("of_map:map_a", {"loc_old": time.time() - 1, "loc_new": time.time() + 50})
    client.expire("of_map:map_a", 50)
    ask(url, lambda cache: cache.put_answer("loc_1", BODY, {}, ["map_a"]))
    assert client.zrange("of_map:map_a", 0, -1) == [b"loc_new", b"loc_1"]
    score = client.zscore("of_map:map_a", "loc_1")
    assert isinstance(score, float)
    assert 490 < score - time.time() <= 500
    assert 490 < int(client.ttl("of_map:map_a")) <= 500


def test_progress_is_told_of_the_revisions_that_have_begun(url: str, cache: WorkerCache, client: "redis.Redis") -> None:
    other = MapRef("map_b", 1)
    cache.report_progress(REF, "reading", "reading the scan", 0.5)
    found = ask(url, lambda each: each.get_progress([other, REF]))
    assert found == {REF: {"status": "reading", "stage": "reading the scan", "progress": 0.5}}
    assert ask(url, lambda each: each.get_progress([])) == {}


def test_a_revision_is_forgotten_alone(url: str, cache: WorkerCache, client: "redis.Redis") -> None:
    for ref in (REF, MapRef("map_a", 22), MapRef("map_a", 1), MapRef("map_b", 2)):
        for digest in (DIGEST, "1e"):
            cache.put_index(ref, digest, b"index")
        cache.report_progress(ref, "reading", "", 0.0)
    ask(url, lambda each: each.forget_revision(REF))
    assert keys(client) == {
        f"{what}:{ref}{digest}"
        for ref in ("map_a:22", "map_a:1", "map_b:2")
        for what, digest in (("index", ":0f"), ("index", ":1e"), ("progress", ""))
    }


def test_a_map_is_forgotten_with_its_answers_and_nothing_of_others(
    url: str, cache: WorkerCache, client: "redis.Redis"
) -> None:
    for ref in (REF, MapRef("map_a", 1), MapRef("map_b", 2)):
        cache.put_index(ref, DIGEST, b"index")
        cache.report_progress(ref, "reading", "", 0.0)

    async def scenario(each: Cache) -> None:
        await each.put_answer("loc_1", BODY, PICTURES, ["map_a"])
        await each.put_answer("loc_2", BODY, PICTURES, ["map_b"])
        await each.forget_map("map_a")
        await each.forget_map("map_unknown")

    ask(url, scenario)
    pictures = {f"picture:loc_2:{name}" for name in ARTIFACTS}
    assert keys(client) == {"index:map_b:2:0f", "progress:map_b:2", "of_map:map_b", "localization:loc_2", *pictures}


@pytest.mark.slow
def test_the_http_process_is_told_when_redis_is_away() -> None:
    questions: tuple[Callable[[Cache], Awaitable[object]], ...] = (
        lambda cache: cache.check(),
        lambda cache: cache.get_progress([REF]),
        lambda cache: cache.put_state("loc_1", {}),
        lambda cache: cache.put_answer("loc_1", {}, {}, []),
        lambda cache: cache.get_localization("loc_1"),
        lambda cache: cache.get_picture("loc_1", "overlay"),
        lambda cache: cache.forget_revision(REF),
        lambda cache: cache.forget_map("map_a"),
    )
    for question in questions:
        with pytest.raises(CacheDownError, match="expected an answer from Redis, got ConnectionError") as told:
            ask("unix:///nowhere/redis.sock", question)
        assert told.value.retry_after_s == 2


def test_a_redis_that_answers_passes_the_check(url: str) -> None:
    ask(url, lambda cache: cache.check())


def test_a_redis_that_was_away_for_a_moment_is_asked_again(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from redis.asyncio.connection import AbstractConnection

    send, num_failures = AbstractConnection.send_packed_command, 2

    async def failing(connection: AbstractConnection, *arguments: object, **options: object) -> None:
        nonlocal num_failures
        if num_failures:
            num_failures -= 1
            raise redis.ConnectionError("gone for a moment")
        await send(connection, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(AbstractConnection, "send_packed_command", failing)
    ask(url, lambda cache: cache.check())
    assert num_failures == 0


def test_whoever_goes_away_just_when_redis_answers_has_gone_away(url: str) -> None:
    async def scenario(cache: Cache) -> None:
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

    ask(url, scenario)


def test_the_look_whether_redis_takes_values_says_so_and_leaves_no_key(url: str, client: "redis.Redis") -> None:
    async def look() -> None:
        cache = Cache(url, result_lifetime_s=10)
        try:
            await cache.check_writable()
        finally:
            await cache.close()

    def is_no_end(said: dict[str, str]) -> bool:
        return said["command"] != "EXEC"

    with client.monitor() as monitor:  # type: ignore[no-untyped-call]
        asyncio.run(look())
        said = [each["command"].split()[0] for each in itertools.takewhile(is_no_end, monitor.listen())]
    assert said[said.index("MULTI") :] == ["MULTI", "SET", "UNLINK"]
    assert keys(client) == set()
    client.config_set("maxmemory", 1)
    client.config_set("maxmemory-policy", "noeviction")
    try:
        with pytest.raises(CacheDownError, match="OutOfMemoryError"):
            asyncio.run(look())
    finally:
        client.config_set("maxmemory", 16 * 2**20)
