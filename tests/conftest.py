"""In which order the files begin where several processes share the tests, and which of them stay together."""

import gc
from collections.abc import Generator
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

# Their tests share one service, which one process can start.
TOGETHER = "tests/integration/one_service/"


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect the tests without looking for garbage among what stays, which takes a sixth of the collection, then or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let files begin first that wait for services, then those that compute long, so that none of them is left for the end."""
    rank_of_file: dict[str, int] = {}
    for item in items:
        rank = 0 if item.get_closest_marker("integration") else 1 if item.get_closest_marker("slow") else 2
        file = _file_of(item)
        rank_of_file[file] = min(rank, rank_of_file.get(file, rank))
    items.sort(key=lambda item: rank_of_file[_file_of(item)])


class FilesOfOneService(LoadFileScheduling):  # type: ignore[misc]  # xdist has no types
    """Gives every file to one process, and those that share a service to the same."""

    def _split_scope(self, nodeid: str) -> str:
        return TOGETHER if nodeid.startswith(TOGETHER) else str(super()._split_scope(nodeid))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> FilesOfOneService | None:
    """Share the tests out by files, where that is asked for."""
    return FilesOfOneService(config, log) if config.getvalue("dist") == "loadfile" else None


def _file_of(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]
