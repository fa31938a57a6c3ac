"""Rows: what one call of a method on one panorama and one map gave; a file of them can be continued and fitted on."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from panoloc.core.config import DISTANCES
from panoloc.core.errors import CoreError

# Metres, degrees.
TIGHT, WRONG = (0.05, 5.0), (0.5, 15.0)
RIGHT = DISTANCES.right.distance_m, DISTANCES.right.angle_deg

RowKey = tuple[str, str, str, str]


class RowsError(CoreError):
    """A file of rows is not one, or its rows lack what was asked of them."""


@dataclass(frozen=True)
class Row:
    """One answer beside the truth.

    group: suite or data set. scan: the map searched; query: the panorama, `scan/name` of where it belongs. cross: the panorama belongs to
    another map, so that `not_localized` is the only right answer. digest: of the method's configuration.
    Errors are None without a pose and for crosses. formal_*: radii before the fit of the confidence, from the curvature alone.
    search: counts of the search, and what confidence rests on (score, runner_up_score, measures, …).
    change: metrics of the change maps by name.
    error: class and message of the exception that ended the call, when one did.
    """

    group: str
    scan: str
    query: str
    method: str
    digest: str
    cross: bool
    status: str
    seconds: float
    confidence: float | None = None
    position_error_m: float | None = None
    orientation_error_deg: float | None = None
    accuracy_position_m: float | None = None
    accuracy_orientation_deg: float | None = None
    formal_position_m: float | None = None
    formal_orientation_deg: float | None = None
    panorama_changed_fraction: float | None = None
    map_changed_fraction: float | None = None
    timings_s: dict[str, float] = field(default_factory=dict)
    search: dict[str, Any] = field(default_factory=dict)
    change: dict[str, float] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)
    error: str | None = None

    @property
    def key(self) -> RowKey:
        """Return what tells rows apart: a later row with the same key replaces an earlier one."""
        return self.scan, self.query, self.method, self.digest

    def within(self, limits: tuple[float, float]) -> bool:
        """Return whether there is a pose within (metres, degrees) of the truth; never for crosses."""
        if self.cross or self.position_error_m is None or self.orientation_error_deg is None:
            return False
        return self.position_error_m <= limits[0] and self.orientation_error_deg <= limits[1]

    @property
    def is_far_off(self) -> bool:
        """Return whether to answer with the pose would be wrong: far off, of another map, or in another of rooms that are alike."""
        return not self.within(WRONG) or self.facts.get("place") == "other"

    @property
    def is_wrong_answer(self) -> bool:
        """Return whether a pose was called localized although it is far off."""
        return self.status == "localized" and self.is_far_off


_FIELDS = {f.name for f in fields(Row)}
_NEEDED = ("group", "scan", "query", "method", "digest", "cross", "status", "seconds")


class RowsFile:
    """Rows as JSON lines; every row is written at once, so that an interrupted run loses at most the call under way."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def rows(self) -> list[Row]:
        """Return all rows, of each key the last. Lines cut off by an interruption are left out; other damage raises RowsError."""
        return list({row.key: row for row in _read(self.path)}.values()) if self.path.exists() else []

    def append(self, row: Row) -> None:
        """Write one row; creates the folder, and ends a line that an interruption cut off."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("ab+") as stream:
            if stream.tell() > 0:
                stream.seek(-1, 2)
                if stream.read(1) != b"\n":
                    stream.write(b"\n")
            stream.write(json.dumps(asdict(row), ensure_ascii=False).encode() + b"\n")


def read_rows(paths: Iterable[Path]) -> list[Row]:
    """Return the rows of several files; raises RowsError when one is missing or damaged."""
    rows: list[Row] = []
    for path in paths:
        if not path.is_file():
            raise RowsError(f"{path}: expected a file of rows as `panoloc evaluate` writes it, found nothing")
        rows += RowsFile(path).rows()
    return rows


def _read(path: Path) -> Iterator[Row]:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            values = json.loads(line)
        except ValueError:
            continue  # cut off by an interruption: that call is made again
        if not isinstance(values, dict) or any(name not in values for name in _NEEDED):
            raise RowsError(f"{path}, line {number}: expected a row with {', '.join(_NEEDED)}; is this a file of rows?")
        yield Row(**{name: value for name, value in values.items() if name in _FIELDS})
