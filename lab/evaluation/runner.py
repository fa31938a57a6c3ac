"""Runs methods on cases and writes one row per answer; what a file of rows already holds is not run again."""

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache

import torch

from panoloc.core.errors import CoreError
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Localization
from panoloc.lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, query_facts
from panoloc.lab.evaluation.methods import ComparedMethod
from panoloc.lab.evaluation.metrics import change_metrics
from panoloc.lab.evaluation.rows import Row, RowsFile


@dataclass(frozen=True)
class RunOptions:
    """How a run goes.

    device: "cpu", "cuda", None to choose. num_strangers: to how many other maps each panorama is sent as well (0: none).
    change_maps: measure the maps of what changed where that is known.
    timeout_s: of one answer, None for no limit. errors: those that give a row which names them, and do not end the run.
    """

    device: str | None = None
    num_strangers: int = 0
    change_maps: bool = False
    timeout_s: float | None = None
    errors: tuple[type[Exception], ...] = (CoreError,)


@dataclass(frozen=True)
class _Call:
    """One answer to be got: the panorama `query` of scan number `owner`, searched in the map of scan number `searched`."""

    owner: int
    query: str
    searched: int
    method: ComparedMethod


class Evaluation:
    """A run: its calls are known from the beginning, so that progress can be shown."""

    def __init__(
        self, scans: Sequence[ScanCases], methods: Sequence[ComparedMethod], file: RowsFile, options: RunOptions
    ) -> None:
        self._scans, self._file, self._options = scans, file, options
        self._calls = list(_calls(scans, methods, options.num_strangers))
        self._localizers: dict[str, Localizer] = {}
        self._maps: dict[str, tuple[MapIndex, float]] = {}
        # Scans and panoramas are large: no more scans are kept than the strangers of a panorama need, and one panorama.
        self._loaded = lru_cache(options.num_strangers + 1)(lambda number: scans[number].load())
        self._query = lru_cache(1)(lambda number, name: self._loaded(number).query(name))

    @property
    def num_calls(self) -> int:
        """Return how many answers the whole run has."""
        return len(self._calls)

    def rows(self, say: Callable[[str], None] = lambda text: None) -> Iterator[tuple[Row, bool]]:
        """Yield every row with whether it is new (False: found in the file); new ones are written first.

        say: receives what is being done. A call that raises one of the errors of the options gives a row that names it.
        """
        known = {row.key: row for row in self._file.rows()}
        for call in self._calls:
            scan, owner = self._scans[call.searched], self._scans[call.owner]
            found = known.get((scan.name, f"{owner.name}/{call.query}", call.method.name, call.method.digest))
            if found is not None and not self._lacks_change(found):
                yield found, False
                continue
            say(f"{call.method.name}: {owner.name}/{call.query} in {scan.name}")
            row = self._answer(call)
            self._file.append(row)
            yield row, True

    def _lacks_change(self, row: Row) -> bool:
        return self._options.change_maps and not row.cross and not row.facts.get("change_maps")

    def _answer(self, call: _Call) -> Row:
        """Make one call and compare its answer with the truth."""
        scan, owner = self._scans[call.searched], self._scans[call.owner]
        cross = call.owner != call.searched
        query, searched = self._query(call.owner, call.query), self._loaded(call.searched)
        index, registration_s = self._map_of(searched)
        facts = {**scan.facts, "tags": list(query.tags), **query_facts(query)}
        facts |= {"registration_s": round(registration_s, 3), "spacing_m": index.spacing}
        facts |= {"num_points": index.num_points, "num_starts": index.num_starts}
        facts["change_maps"] = self._options.change_maps and not cross
        began = time.perf_counter()
        answer, error = None, None
        try:
            localizer = self._localizer(call.method)
            began = time.perf_counter()
            answer = localizer.localize(
                query.query,
                [index],
                method=call.method.method,
                hints=query.hints,
                timeout_s=self._options.timeout_s,
            )
        except self._options.errors as raised:
            error = f"{type(raised).__name__}: {raised}"
        seconds = time.perf_counter() - began
        known = (scan.group, scan.name, f"{owner.name}/{call.query}", call.method.name, call.method.digest, cross)
        if answer is None:
            return Row(*known, "error", seconds, facts=facts, error=error)
        change: dict[str, float] = {}
        if facts["change_maps"] and query.changed_pixels is not None:
            change = change_metrics(query, searched.cloud, index, answer)
        return _row_of(known, seconds, answer, query, change, facts)

    def _localizer(self, method: ComparedMethod) -> Localizer:
        if method.digest not in self._localizers:
            self._localizers[method.digest] = Localizer(method.config, self._options.device)
        return self._localizers[method.digest]

    def _map_of(self, scan: LoadedScan) -> tuple[MapIndex, float]:
        """Return the map of a scan and the seconds that it took to build: suites with other cameras show the same scan.

        The maps asked for last are kept, one for each scan of a call: they are large.
        """
        key = _digest(scan)
        if key in self._maps:
            found = self._maps.pop(key)
        else:
            while len(self._maps) > self._options.num_strangers:
                del self._maps[next(iter(self._maps))]
            began = time.perf_counter()
            device = self._options.device or ("cuda" if torch.cuda.is_available() else "cpu")
            index = build_map_index(scan.cloud, scan.options, device=device)
            found = index, time.perf_counter() - began
        self._maps[key] = found  # the last one in it is the last one asked for
        return found


def _calls(scans: Sequence[ScanCases], methods: Sequence[ComparedMethod], num_strangers: int) -> Iterator[_Call]:
    """Yield the calls scan by scan, those of one place together, so that they find its map: all queries in their own map, then in the
    maps of the next scans of other places."""
    first_of = {scan.place: number for number, scan in reversed(list(enumerate(scans)))}
    for owner, scan in sorted(enumerate(scans), key=lambda each: first_of[each[1].place]):
        following = [*range(owner + 1, len(scans)), *range(owner)]
        strangers = [number for number in following if scans[number].place != scan.place][:num_strangers]
        for searched in (owner, *strangers):
            yield from (_Call(owner, query, searched, method) for query in scan.query_names for method in methods)


def _digest(scan: LoadedScan) -> str:
    """Return what only scans with the same points, colours and options have."""
    cloud = scan.cloud
    found = hashlib.sha256(repr((scan.options, cloud.num_points_read)).encode())
    for array in (cloud.positions, cloud.colors, cloud.origin_offset):
        found.update(repr((array.dtype, array.shape)).encode())
        found.update(array.tobytes())
    return found.hexdigest()


def _row_of(
    known: tuple[str, str, str, str, str, bool],
    seconds: float,
    answer: Localization,
    query: KnownQuery,
    change: dict[str, float],
    facts: dict[str, object],
) -> Row:
    search = asdict(answer.search)
    if answer.best is not None and answer.evidence is not None:
        if not known[-1] and (place := query.place_of(answer.best.pose)) is not None:
            listed = (answer.best, *answer.alternatives)
            facts |= {"place": place, "own_listed": any(query.place_of(one.pose) == "own" for one in listed)}
        search |= {"score": answer.best.score, "sampling_loss": answer.best.sampling_loss, **asdict(answer.evidence)}
    formal = search.pop("formal_radii", None)
    error = None if answer.best is None or known[-1] else query.error_of(answer.best.pose)
    return Row(
        *known,
        status=answer.status,
        seconds=seconds,
        confidence=None if answer.best is None else answer.best.confidence,
        position_error_m=None if error is None else error.position_m,
        orientation_error_deg=None if error is None else error.orientation_deg,
        accuracy_position_m=answer.accuracy_position_m,
        accuracy_orientation_deg=answer.accuracy_orientation_deg,
        formal_position_m=None if formal is None else formal[0],
        formal_orientation_deg=None if formal is None else formal[1],
        panorama_changed_fraction=answer.panorama_changed_fraction,
        map_changed_fraction=answer.map_changed_fraction,
        timings_s={name: round(value, 5) for name, value in answer.timings_s.items()},
        search=search,
        change=change,
        facts=facts,
    )
