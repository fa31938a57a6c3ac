"""In which order the engine takes rounds of search, and the portions of poses that they propose, where a rig has several focal lengths."""

from collections.abc import Callable, Sequence
from typing import Any

import pytest
import torch

from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.confidence import load_confidence_model
from panoloc.core.query import engine as steps
from panoloc.core.query.engine import Engine
from panoloc.core.stage_clock import StageClock


class Noted:
    """A contest that notes what is asked of it; in each round its best pose has the next of some scores."""

    def __init__(self, name: str, scores: Sequence[float], notes: list[str]) -> None:
        self.name, self.queries, self._scores, self._notes = name, name, list(scores), notes

    def take(self, portion: str) -> None:
        self._notes.append(f"{self.name} takes {portion}")

    def rank(self) -> None:
        self._notes.append(f"{self.name} ranks")

    def add(self, portion: str) -> None:
        self._notes.append(f"{self.name} adds {portion}")

    def best_score(self) -> float:
        return self._scores[sum(note.startswith(f"{self.name} takes") for note in self._notes) - 1]


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[str, int, list[str]]]:
    def search(
        rounds: dict[str, int], scores: dict[str, Sequence[float]], sure_after: str
    ) -> tuple[str, int, list[str]]:
        """Search with contests by name; return whose answer it is, how many poses were scored, and the notes."""
        notes: list[str] = []
        contests: Any = [Noted(name, of_name, notes) for name, of_name in scores.items()]
        monkeypatch.setattr(steps, "rounds_of", lambda name, config: iter(range(1, rounds[name] + 1)))
        monkeypatch.setattr(steps, "propose", lambda name, number, config: ([f"{number}a", f"{number}b"], 5, 10))
        monkeypatch.setattr(Engine, "is_sure", lambda engine, contest: notes[-1] == sure_after)
        clock = StageClock(None, torch.device("cpu"))
        best, num_starts, num_poses = Engine(LocalizerConfig(), load_confidence_model())._search(contests, clock)
        assert num_starts == 5
        return best.name, num_poses, notes  # type: ignore[attr-defined]

    return search


def test_every_portion_of_the_best_is_added_and_the_best_may_change(searched: Any) -> None:
    best, num_poses, notes = searched({"wide": 2, "narrow": 2}, {"wide": [0.5, 0.9], "narrow": [0.7, 0.7]}, "")
    first = ["wide takes 1a", "narrow takes 1a", "narrow ranks", "narrow adds 1b"]
    second = ["wide takes 2a", "narrow takes 2a", "wide ranks", "wide adds 1b", "wide adds 2b"]
    assert (best, num_poses, notes) == ("wide", 40, first + second)


@pytest.mark.parametrize(("sure_after", "count"), [("only ranks", 2), ("only adds 1b", 3), ("only adds 2b", 6)])
def test_nothing_is_searched_any_more_once_an_answer_is_sure(searched: Any, sure_after: str, count: int) -> None:
    _, _, notes = searched({"only": 3}, {"only": [0.5] * 3}, sure_after)
    assert (notes[-1], len(notes)) == (sure_after, count)


def test_one_with_fewer_rounds_waits_for_the_others(searched: Any) -> None:
    best, num_poses, notes = searched({"short": 1, "long": 2}, {"short": [0.5], "long": [0.4, 0.6]}, "")
    assert (best, num_poses) == ("long", 30)
    assert "short takes 2a" not in notes
