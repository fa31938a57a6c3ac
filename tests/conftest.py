"""What processes that share the tests have in common, in which order files begin, which stay together, and which coverage watches."""

import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Generator, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

# Their tests share one service, which one process can start.
TOGETHER = "tests/integration/one_service/"
# Their tests wait for half of their time: beside each other they would leave processors idle.
WAITING = "tests/service/"
# Python runs at half its speed where coverage watches. So it watches the quick tests of what it covers, and those slow ones without
# which lines would seem untested.
WATCHED = ("tests/core/", "tests/service/")
WATCHED_THOUGH_SLOW = ("tests/core/changes/", "tests/core/paper/", "tests/core/scan/", "tests/service/")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Stop what pytest-cov starts too early, and give processes that share the tests a folder for maps.

    Where several processes share the tests, it starts in each as if that were alone, and then once more. To pause the second would wake the
    first. The process that hands the tests out runs none, and need not be watched.
    """
    shares = not hasattr(session.config, "workerinput") and session.config.getoption("numprocesses", None)
    # Shells let what they start in the background ignore it, and so would every process that a test ends with it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    coverage = _coverage(session.config)
    if coverage and (hasattr(session.config, "workerinput") or shares):
        coverage.pause()
    if shares:
        os.environ["MAPS_OF_TESTS"] = tempfile.mkdtemp()


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Remove the maps that processes had in common (tests/core/built_maps.py)."""
    if not hasattr(session.config, "workerinput") and (folder := os.environ.pop("MAPS_OF_TESTS", None)):
        shutil.rmtree(folder)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Collect the tests without looking for garbage among what stays, which takes a sixth of the collection, then or later.

    Each process imports the same, so coverage watches the first one alone.
    """
    worker = getattr(session.config, "workerinput", {"workerid": "gw0"})["workerid"]
    gc.disable()
    try:
        with nullcontext() if worker == "gw0" else _unwatched(session.config):
            return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    with _unwatched(item.config) if item.get_closest_marker("unwatched") else nullcontext():
        return (yield)


def _coverage(config: pytest.Config) -> Any:
    plugin = config.pluginmanager.getplugin("_cov")
    return plugin and plugin.cov_controller


@contextmanager
def _unwatched(config: pytest.Config) -> Iterator[None]:
    coverage = _coverage(config)
    if coverage:
        coverage.pause()
    try:
        yield
    finally:
        if coverage:
            coverage.resume()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let files begin first that start services; then those that mostly wait and those that compute in turn, the slow ones first."""
    rank_of_file: dict[str, int] = {}
    for item in items:
        rank = 0 if item.get_closest_marker("integration") else 1 if item.get_closest_marker("slow") else 2
        file = _file_of(item)
        rank_of_file[file] = min(rank, rank_of_file.get(file, rank))
        if not file.startswith(WATCHED if rank == 2 else WATCHED_THOUGH_SLOW):
            item.add_marker("unwatched")
    place_of_file: dict[str, float] = {}
    for waits in (False, True):
        files = [file for file, rank in rank_of_file.items() if rank and file.startswith(WAITING) == waits]
        files.sort(key=rank_of_file.__getitem__)
        place_of_file |= {file: (number + 1) / len(files) for number, file in enumerate(files)}
    items.sort(key=lambda item: place_of_file.get(_file_of(item), 0.0))


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
