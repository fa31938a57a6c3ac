"""A campus of procedural rooms and flats: how surely, and how soon, a query is found in the right one of many maps.

Nothing is kept in memory but retrieval vectors: every map that is searched is read from disk, as where a thousand of them do not fit.
"""

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import median, quantiles

from panoloc.core.camera.rig import Rig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.localizer import Localizer
from panoloc.core.many_maps import localize_among
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_codec import decode_map_index, encode_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.retrieval_vectors import (
    RetrievalVectors,
    decode_retrieval_vectors,
    encode_retrieval_vectors,
    retrieval_vectors,
)
from panoloc.core.options import Hints, Status
from panoloc.lab.evaluation.rows import RIGHT
from panoloc.lab.rooms.capture.scanning import scan_with_truth
from panoloc.lab.rooms.scenes.generator import SceneKind, SceneSpec, build_scene
from panoloc.lab.rooms.suites import suite_cases

_FIRST_SEED = 20_000
_FLAT_EVERY = 5
_TWIN_SHARE = 0.1
_POINTS = 150_000
_QUERY_POINTS = 20_000  # of scans that queries are made beside, and that nobody looks at
_READ_AT_ONCE = 2


@dataclass(frozen=True)
class Campus:
    """Maps in a folder, made when they are asked for. The last tenth are the first ones scanned again: twins, as equal rooms are."""

    folder: Path
    num_maps: int

    @property
    def num_places(self) -> int:
        """Return how many maps are of places of their own."""
        return self.num_maps - round(_TWIN_SHARE * self.num_maps)

    def twin_of(self, number: int) -> int | None:
        """Return the map that was scanned in an equal room."""
        twin = number + self.num_places
        return twin if twin < self.num_maps else None

    def kind_of(self, number: int) -> SceneKind:
        """Return what a map is of, "room" or "flat"."""
        return "flat" if number % self.num_places % _FLAT_EVERY == _FLAT_EVERY - 1 else "room"

    def seed_of(self, number: int) -> int:
        """Return the seed of the scene that a map is of."""
        return _FIRST_SEED + number % self.num_places

    def build(self, number: int) -> None:
        """Write the index and the retrieval vectors of a map, unless they are there."""
        index_path, vectors_path = self.path(number), self.path(number, ".npz")
        if index_path.exists() and vectors_path.exists():
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        scene = build_scene(SceneSpec(self.kind_of(number), self.seed_of(number)))
        scan = scan_with_truth(scene, num_points=_POINTS, seed=number)
        index = build_map_index(scan.cloud)
        index_path.write_bytes(encode_map_index(index))
        vectors_path.write_bytes(encode_retrieval_vectors(retrieval_vectors(index)))

    def path(self, number: int, suffix: str = ".plmi") -> Path:
        """Return the file of a map."""
        # A twin is one of so many maps alone.
        name = f"{number}" if number < self.num_places else f"twin-{number - self.num_places}"
        return self.folder / f"{name}{suffix}"


@dataclass(frozen=True)
class KnownPlace:
    """A query with its truth: the map that it was taken in, and the pose there."""

    map_number: int
    query: Rig
    pose: Pose
    hints: Hints | None


def campus_queries(campus: Campus, count: int, camera: str | None) -> Iterator[KnownPlace]:
    """Yield queries in changed rooms and flats, evenly spread over the places of a campus, twins first. camera: None for panoramas."""
    for number in range(0, campus.num_places, max(1, campus.num_places // count))[:count]:
        suite = "flats_changed" if campus.kind_of(number) == "flat" else "changed"
        name = suite if camera is None else f"{suite}/{camera}"
        (case,) = suite_cases(name, [campus.seed_of(number)], num_points=_QUERY_POINTS)
        yield KnownPlace(number, case.query, case.pose, case.hints)


class CampusMaps:
    """The maps of a campus as a query has them. loaded: the numbers of those that were read."""

    def __init__(self, campus: Campus, vectors: Sequence[RetrievalVectors]) -> None:
        self._campus, self._vectors = campus, vectors
        self.loaded: list[int] = []

    def __len__(self) -> int:
        return len(self._vectors)

    def vectors(self) -> Sequence[RetrievalVectors]:
        """Return the retrieval vectors of all maps."""
        return self._vectors

    def indexes(self, numbers: Sequence[int]) -> Sequence[MapIndex]:
        """Read the indexes of some maps."""
        self.loaded += numbers
        with ThreadPoolExecutor(_READ_AT_ONCE) as threads:
            return list(threads.map(lambda n: decode_map_index(self._campus.path(n).read_bytes()), numbers))


@dataclass(frozen=True)
class CampusRow:
    """What became of one query. rank: of the right map among those that were loaded, None where it was not. in_right_map: or in its
    twin, which nobody can tell apart. is_right: there, within 0.3 m and 10 degrees."""

    map_number: int
    status: Status
    confidence: float
    seconds: float
    rank: int | None
    in_right_map: bool
    is_right: bool


def campus_rows(
    campus: Campus, vectors: Sequence[RetrievalVectors], queries: Sequence[KnownPlace], localizer: Localizer
) -> Iterator[CampusRow]:
    """Localize queries among all maps."""
    for each in queries:
        maps, began = CampusMaps(campus, vectors), time.perf_counter()
        found = localize_among(localizer, each.query, maps, hints=each.hints)
        seconds, best = time.perf_counter() - began, found.best
        places = {each.map_number, campus.twin_of(each.map_number)}
        in_right_map = best is not None and best.map_position in places
        is_right = in_right_map and best is not None and pose_error(best.pose, each.pose).within(*RIGHT)
        rank = maps.loaded.index(each.map_number) if each.map_number in maps.loaded else None
        confidence = 0.0 if best is None else best.confidence
        yield CampusRow(each.map_number, found.status, confidence, seconds, rank, in_right_map, is_right)


def read_vectors(campus: Campus) -> list[RetrievalVectors]:
    """Read the retrieval vectors of all maps."""
    return [decode_retrieval_vectors(campus.path(n, ".npz").read_bytes()) for n in range(campus.num_maps)]


def campus_summary(
    campus: Campus, vectors: Sequence[RetrievalVectors], rows: Sequence[CampusRow]
) -> dict[str, float | int]:
    """Return the figures of a campus. recall: the right map was among those loaded. wrong: localized where the query was not taken;
    twin_sure: localized where there is an equal room."""
    seconds = [row.seconds for row in rows]
    answered = [row for row in rows if row.status == "localized"]
    return {
        "maps": campus.num_maps,
        "starts": sum(map(len, vectors)),
        "vectors_mb": round(sum(each.num_bytes for each in vectors) / 1e6, 1),
        "queries": len(rows),
        "right_map_first": _share(row.in_right_map for row in rows),
        "right": _share(row.is_right for row in rows),
        "localized": _share(row.status == "localized" for row in rows),
        "ambiguous": _share(row.status == "ambiguous" for row in rows),
        "wrong": sum(not row.is_right for row in answered),
        "twin_sure": sum(campus.twin_of(row.map_number) is not None for row in answered),
        "recall": _share(row.rank is not None for row in rows),
        "p50_s": round(median(seconds), 3),
        "p90_s": round(quantiles(seconds, n=10)[-1] if len(seconds) > 1 else seconds[0], 3),
    }


def _share(flags: Iterator[bool]) -> float:
    counted = list(flags)
    return round(sum(counted) / len(counted), 3)
