"""The service of all tests here and a map of the small room in it: to start one takes longer than most of them."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService
from tests.integration.small_room import OPTIONS, small_room


@pytest.fixture(scope="package")
def own_redis() -> Iterator[RealRedis | None]:
    """Return a Redis of the operator's; None: the service starts its own."""
    if shutil.which("redis-server") is None:
        yield None
        return
    with RealRedis() as server:
        yield server


@pytest.fixture(scope="package")
def service(own_redis: RealRedis | None) -> Iterator[RunningService]:
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        settings = {} if own_redis is None else {"redis_url": own_redis.url}
        running = RunningService(Path(folder) / "data", **settings)
        try:
            running.wait_until_ready()
            yield running
        finally:
            running.stop()


@pytest.fixture(scope="package")
def map_id(service: RunningService) -> str:
    return service.register(small_room().scan, OPTIONS)
