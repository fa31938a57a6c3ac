"""An application on an empty Redis, in this event loop or on a port.

The marker `settings` configures the application of the fixture `running`.
"""

import logging
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path

import pytest
import structlog

from tests.service.http.running_service import Listen, RunningService, Serve, listening, running_service


@pytest.fixture(scope="session", autouse=True)
def _quiet_logs() -> None:
    structlog.configure(
        processors=[structlog.processors.format_exc_info, structlog.processors.JSONRenderer()],
        wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR),
    )


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def serve(tmp_path: Path, redis_url: str) -> Serve:
    """Return what runs an application on the folder and the Redis of the test: `async with serve(max_maps=1)`."""
    return partial(running_service, tmp_path, redis_url)


@pytest.fixture
def listen(tmp_path: Path, redis_url: str) -> Listen:
    """Return what serves such an application on a port, and yields its URL."""
    return partial(listening, tmp_path, redis_url)


@pytest.fixture
async def running(request: pytest.FixtureRequest, serve: Serve, anyio_backend: str) -> AsyncIterator[RunningService]:
    marker = request.node.get_closest_marker("settings")
    async with serve(**({} if marker is None else marker.kwargs)) as running:
        yield running
