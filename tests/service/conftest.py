"""One Redis and one S3 for the tests of a process: Redis emptied for each test, S3 with a prefix for each."""

import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
import redis

from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.storage.bucket import BucketStorage
from tests.service.started_redis import started_redis
from tests.service.storage.bucket_server import BucketServer


@pytest.fixture(scope="session")
def redis_server() -> Iterator[EmbeddedRedis]:
    with started_redis() as server:
        yield server


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


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"
