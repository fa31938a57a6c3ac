"""What workers keep in a real Redis, for how long, and what they are told while it is away."""

import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import redis

from service.cache import WorkerCache
from service.errors import CacheDownError
from service.host.embedded_redis import EmbeddedRedis
from service.host.lifeline import Lifeline
from service.jobs import MapRef

REF, DIGEST = MapRef("map_a", 2), "0f"
INDEX, PROGRESS = "index:map_a:2:0f", "progress:map_a:2"


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    # pytest's own folders are too long for a socket.
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        lifeline = Lifeline()
        server = EmbeddedRedis(Path(folder), lifeline, max_memory_bytes=16 * 2**20)
        server.start()
        yield server.url
        server.stop()
        lifeline.close()


@pytest.fixture
def client(url: str) -> Iterator["redis.Redis"]:
    with redis.Redis.from_url(url) as client:
        client.flushall()
        yield client


@pytest.fixture
def cache(url: str, client: "redis.Redis") -> Iterator[WorkerCache]:
    cache = WorkerCache(url, index_lifetime_s=1000, progress_lifetime_s=300)
    yield cache
    cache.close()


def test_an_index_is_read_back_and_lives_for_a_time(cache: WorkerCache, client: "redis.Redis") -> None:
    cache.put_index(REF, DIGEST, b"\x00index\xff")
    assert cache.get_index(REF, DIGEST) == b"\x00index\xff"
    assert client.keys() == [INDEX.encode()]
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
    assert len(client.keys()) == 3


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


def test_a_fault_that_does_not_pass_by_itself_is_not_called_away(cache: WorkerCache, client: "redis.Redis") -> None:
    client.lpush(INDEX, "not what we keep there")
    with pytest.raises(redis.ResponseError):
        cache.get_index(REF, DIGEST)
