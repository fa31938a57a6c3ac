"""One Redis and one S3 for the tests of a process: Redis emptied for each test, S3 with a prefix for each."""

import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
import redis

from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.storage.bucket import BucketStorage
from tests.service.storage.bucket_server import BucketServer


@pytest.fixture(scope="session")
def redis_server() -> Iterator[EmbeddedRedis]:
    # pytest's own folders are too long for a socket.
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        server = EmbeddedRedis(Path(folder), max_memory_bytes=64 * 2**20)
        server.start()
        yield server
        server.stop()


@pytest.fixture
def redis_client(redis_server: EmbeddedRedis) -> Iterator["redis.Redis"]:
    with redis.Redis.from_url(redis_server.url, decode_responses=True) as client:
        client.flushall()
        yield client


@pytest.fixture
def redis_url(redis_server: EmbeddedRedis, redis_client: "redis.Redis") -> str:
    """Return the URL of the empty Redis."""
    return redis_server.url


@pytest.fixture(scope="session")
def bucket_server() -> Iterator[BucketServer]:
    server = BucketServer()
    yield server
    server.stop()


@pytest.fixture
def prefix() -> str:
    return uuid.uuid4().hex


@pytest.fixture
def bucket(bucket_server: BucketServer, prefix: str, tmp_path: Path) -> BucketStorage:
    return bucket_server.storage(tmp_path / "machine", prefix)
