"""The measurement itself: what it changes, and that a changed file is what the tests see."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.mutation.score import Mutant

ROOT = Path(__file__).parents[2]

SOURCE = '''"""A module."""

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
def score() -> ModuleType:
    # Here, because every process that shares the tests imports this file, and what the measurement needs takes long to load.
    from tests.mutation import score

    return score


@pytest.fixture(scope="module")
def mutants(score: ModuleType) -> "list[Mutant]":
    made = [make() for make in score.changes_of("service/made_up.py", SOURCE)]
    return [mutant for mutant in made if mutant is not None]


def test_every_mutant_differs_in_one_line_of_a_function_also_of_one_with_a_decorator(mutants: "list[Mutant]") -> None:
    changed = set()
    for mutant in mutants:
        pairs = zip(SOURCE.splitlines(), mutant.source.splitlines(), strict=True)
        (number,) = (number for number, (old, new) in enumerate(pairs, 1) if old != new)
        assert number == mutant.line
        changed.add(number)
    assert changed == {8, 17, 21}


def test_texts_for_people_stay(mutants: "list[Mutant]") -> None:
    assert all("a text for people" in mutant.source for mutant in mutants)
    assert any('"COUNTER"' in mutant.source for mutant in mutants)


@pytest.mark.slow
def test_every_mutated_file_has_tests_that_concern_it(score: ModuleType) -> None:
    for pattern in score.MUTATED:
        files = [str(path.relative_to(ROOT)) for path in ROOT.glob(pattern)]
        assert files, pattern
        assert all((ROOT / test).exists() for file in files for test in score.concerning_tests(file))


NOTICES = """
import os
from panoloc.lab.process_memory import proportional_bytes


def test_a_process_takes_memory() -> None:
    assert proportional_bytes(os.getpid()) > 0
"""
PROGRAM = """
import sys
from tests.mutation.score import Mutant, outcome
source = open("lab/process_memory.py").read()
changes = {"none": "", "fault": "proportional_bytes = lambda pid: 0", "for ever": "while True: pass"}
for name, change in changes.items():
    mutant = Mutant("lab/process_memory.py", 1, name, source + change)
    print(name, outcome([sys.argv[1]], mutant, 60.0 if name != "for ever" else 0.5), sep=": ")
"""


@pytest.mark.slow
def test_tests_see_the_changed_file_and_one_that_runs_for_ever_is_ended(tmp_path: Path) -> None:
    test = tmp_path / "test_memory.py"  # away from the tests here, whose fixtures take long to load
    test.write_text(NOTICES)
    command = [sys.executable, "-c", PROGRAM, str(test)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=280)
    assert done.stdout.splitlines() == ["none: lives", "fault: noticed", "for ever: timed out"], done.stderr
