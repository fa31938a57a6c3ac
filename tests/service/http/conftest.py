"""One real Redis for all tests of the API, emptied for each, and an application on it."""

import logging
import tempfile
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
import redis
import structlog

from panoloc.service.host.embedded_redis import EmbeddedRedis
from tests.service.http.running_service import RunningService, running_service


@pytest.fixture(scope="session", autouse=True)
def _quiet_logs() -> None:
    structlog.configure(
        processors=[structlog.processors.format_exc_info, structlog.processors.JSONRenderer()],
        wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR),
    )


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


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
async def running(
    tmp_path: Path, redis_server: EmbeddedRedis, redis_client: "redis.Redis", anyio_backend: str
) -> AsyncIterator[RunningService]:
    async with running_service(tmp_path, redis_server.url) as running:
        yield running
