"""The measurement itself: what it changes, that a changed file is what the tests see, and that its table is up to date."""

import ast
import os
import subprocess
import sys

import pytest

from tests.mutation.mutants import MutableFile, Mutant
from tests.mutation.targets import ROOT, targets

SOURCE = '''"""A module."""

from contextlib import contextmanager

LIMIT = 5


def doubled(number: int) -> int:
    """Return twice the number."""
    return number * 2


class Counter:
    """Counts."""

    @property
    def is_full(self) -> bool:
        """Tell whether it is full."""
        return self.count > LIMIT

    def name(self, text: str = "a text for people") -> str:
        """Return a name."""
        return text or "counter"
'''


@pytest.fixture(scope="module")
def mutants() -> list[Mutant]:
    file = MutableFile("service/made_up.py", SOURCE)
    made = [file.mutant(number) for number in range(len(file))]
    return [mutant for mutant in made if mutant is not None]


def test_every_function_is_changed_also_one_with_a_decorator_and_nothing_else(mutants: list[Mutant]) -> None:
    assert {mutant.name.partition("::")[2].partition("#")[0] for mutant in mutants} == {
        "doubled",
        "Counter.is_full",
        "Counter.name",
    }
    assert all("LIMIT = 5" in mutant.source for mutant in mutants)


def test_every_mutant_is_another_program_that_differs_in_one_place(mutants: list[Mutant]) -> None:
    programs = [ast.dump(ast.parse(mutant.source)) for mutant in mutants]
    assert len(set(programs) | {ast.dump(ast.parse(SOURCE))}) == len(mutants) + 1
    for mutant in mutants:
        lines = [new for old, new in zip(SOURCE.splitlines(), mutant.source.splitlines(), strict=True) if old != new]
        assert len(lines) == 1, mutant
        assert SOURCE.splitlines()[mutant.line - 1] not in lines


def test_texts_for_people_stay(mutants: list[Mutant]) -> None:
    assert all("a text for people" in mutant.source for mutant in mutants)
    assert any('"COUNTER"' in mutant.source for mutant in mutants)


def test_a_mutant_is_found_again_by_its_name(mutants: list[Mutant]) -> None:
    file = MutableFile("service/made_up.py", SOURCE)
    assert file.named(mutants[3].name) == mutants[3]
    assert file.named("service/made_up.py::nothing#1") is None


def test_the_table_names_files_and_tests_that_are_there() -> None:
    found = targets()
    assert len({target.file for target in found}) == len(found) > 15
    assert all((ROOT / name).exists() for target in found for name in (target.file, *target.tests))


PROGRAM = """
import time
from tests.mutation import runner
from tests.mutation.mutants import Mutant
source = open("service/ray/queue/admission.py").read()
changes = {
    "none": "",
    "fault": "Admission.num_admitted = property(lambda self: -1)",
    "for ever": "Admission.set_num_workers = lambda *_: exec('while True: pass')",
}
for name, change in changes.items():
    mutant = Mutant(name, "service/ray/queue/admission.py", 1, "", "", source + change)
    child = runner.start(["tests/service/ray/queue/test_admission.py"], mutant, 200.0 if name != "for ever" else 4.0)
    while (end := runner.ended(child)) is None:
        time.sleep(0.02)
    print(name, end.status, sep=": ")
"""


@pytest.mark.slow
def test_tests_see_the_changed_file_and_whoever_runs_for_ever_is_ended() -> None:
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, cwd=ROOT, env=environment, timeout=280
    )
    assert done.stdout.splitlines() == ["none: lives", "fault: noticed", "for ever: timed out"], done.stderr


@pytest.mark.slow
def test_the_command_shows_what_it_would_run() -> None:
    command = [
        sys.executable,
        "-m",
        "tests.mutation",
        "--list",
        "--sample",
        "3",
        "--only",
        "service/ray/queue/admission.py",
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=240, check=True)
    assert len(done.stdout.splitlines()) == 3
    assert all(line.startswith("service/ray/queue/admission.py::Admission.") for line in done.stdout.splitlines())
