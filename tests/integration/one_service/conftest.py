"""The service of all tests here and a map of the small room in it: to start one takes longer than most of them."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.running_service import RunningService
from tests.integration.small_room import OPTIONS, small_room


@pytest.fixture(scope="package")
def service() -> Iterator[RunningService]:
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        running = RunningService(Path(folder) / "data")
        try:
            running.wait_until_ready()
            yield running
        finally:
            running.stop()


@pytest.fixture(scope="package")
def map_id(service: RunningService) -> str:
    return service.register(small_room().scan, OPTIONS)
