"""What the options of `panoloc bench` ask for."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lab.benchmark.sizes import FULL, QUICK, Sizes

DEFAULT_CLIENTS = (1, 4, 16)
_QUERIES, _QUICK_QUERIES = 48, 4
_QUICK_CLIENTS = (1, 2)
_SETTLE_S, _QUICK_SETTLE_S = 3.0, 1.0


@dataclass(frozen=True)
class BenchRequest:
    """The options of the command; lab/commands/bench.py says what each means. None: what the chosen sizes say."""

    parts: tuple[str, ...]
    quick: bool
    points: int | None
    large_points: int | None
    starts: int | None
    width: int | None
    repeats: int | None
    queries: int | None
    clients: tuple[int, ...]
    paper: bool
    paper_timeout_s: float
    url: str | None
    device: str | None
    threads: int | None
    out: Path

    @property
    def sizes(self) -> Sizes:
        """Return the sizes of everything."""
        given: dict[str, Any] = {
            "points": self.points,
            "starts": self.starts,
            "width": self.width,
            "repeats": self.repeats,
        }
        return replace(QUICK if self.quick else FULL, **{k: v for k, v in given.items() if v is not None})

    @property
    def num_queries(self) -> int:
        """Return how many queries each number of clients sends."""
        return self.queries or (_QUICK_QUERIES if self.quick else _QUERIES)

    @property
    def num_clients(self) -> tuple[int, ...]:
        """Return the numbers of clients at the same time."""
        return self.clients or (_QUICK_CLIENTS if self.quick else DEFAULT_CLIENTS)

    @property
    def settle_s(self) -> float:
        """Return the seconds after which a service counts as idle."""
        return _QUICK_SETTLE_S if self.quick else _SETTLE_S
