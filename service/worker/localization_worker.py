"""The worker that answers queries: loads the map's index, decodes the images, localizes them, draws the pictures."""

import contextlib
import gc
import logging
import os
import socket
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from panoloc.core.camera.rig import Rig
from panoloc.core.decide.pictures import draw_overlay, draw_score_map_2d, draw_score_map_3d, encode_png, view_scan
from panoloc.core.errors import DeadlineExceededError, IndexFormatError
from panoloc.core.kernels.library import use_threads
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import index_config_digest
from panoloc.core.map.map_codec import decode_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Localization
from panoloc.service.cache import WorkerCache
from panoloc.service.errors import CacheDownError
from panoloc.service.host.process_resources import keep_freed_memory, num_usable_cpus
from panoloc.service.jobs import LocalizeJob, LocalizeOutcome, MapRef
from panoloc.service.storage import Storage
from panoloc.service.worker.answers import answer_of, change_cells
from panoloc.service.worker.map_catalog import registration_of, stored_index
from panoloc.service.worker.plan import WorkerSettings
from panoloc.service.worker.query_images import as_found, read_query, shown_on_sphere
from panoloc.service.worker.reply import WorkerReply, guarded

_log = logging.getLogger(__name__)
Result = TypeVar("Result")


class ResidentIndexes:
    """Indexes in memory, bounded by bytes; the least recently used make room. Not thread-safe: a worker computes in one thread."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._held: dict[MapRef, MapIndex] = {}  # the least recently used first

    @property
    def num_bytes(self) -> int:
        """Return the bytes of everything held."""
        return sum(index.num_bytes for index in self._held.values())

    def get(self, ref: MapRef) -> MapIndex | None:
        """Return an index, None when it is not held; it becomes the most recently used."""
        if ref in self._held:
            self._held[ref] = self._held.pop(ref)
        return self._held.get(ref)

    def put(self, ref: MapRef, index: MapIndex) -> None:
        """Hold an index that is not held yet, unless it is larger than all room."""
        if index.num_bytes <= self._max_bytes:
            while self.num_bytes + index.num_bytes > self._max_bytes:
                del self._held[next(iter(self._held))]
            self._held[ref] = index


class LocalizationWorker:
    """Holds a localizer and the indexes used last. Computes in one thread."""

    def __init__(self, settings: WorkerSettings, localizer: Localizer, storage: Storage, cache: WorkerCache) -> None:
        self._settings = settings
        self._localizer = localizer
        self._storage = storage
        self._cache = cache
        self._resident = ResidentIndexes(settings.resident_bytes)
        self._name = f"{socket.gethostname()}-{os.getpid()}"

    def localize(self, job: LocalizeJob) -> WorkerReply[LocalizeOutcome]:
        """Answer one query, or name the indexes that have to be built again first."""
        began = time.monotonic()
        query = _RunningQuery(job, self._localizer, self._settings)
        outcome, failure = guarded(lambda: query.answer(self._index_of))
        return WorkerReply(
            outcome=outcome,
            failure=failure,
            missing=tuple(query.missing),
            worker=self._name,
            duration_s=time.monotonic() - began,
            resident_bytes=self._resident.num_bytes,
            index_loads=query.index_loads,
        )

    def _index_of(self, map_ref: MapRef) -> tuple[str, MapIndex | None]:
        """Return where the index came from, "resident", "redis" or "storage", and the index.

        A copy from storage goes back into Redis. "missing" and None when the index has to be built again.
        """
        index = self._resident.get(map_ref)
        if index is not None:
            return "resident", index
        digest = index_config_digest(registration_of(self._storage, map_ref).options.index)
        source, encoded = "redis", self._cache.get_index(map_ref, digest)
        index = self._decoded(map_ref, encoded)
        if index is None:
            source, encoded = "storage", stored_index(self._storage, map_ref, digest)
            index = self._decoded(map_ref, encoded)
            if encoded is None or index is None:
                return "missing", None
            with contextlib.suppress(CacheDownError):  # a full Redis: the copy is as good
                self._cache.put_index(map_ref, digest, encoded)
        self._resident.put(map_ref, index)
        return source, index

    def _decoded(self, map_ref: MapRef, encoded: bytes | None) -> MapIndex | None:
        """Return the index, None when it is missing or cannot be read."""
        if encoded is None:
            return None
        try:
            return decode_map_index(encoded, str(self._localizer.device))
        except IndexFormatError as error:
            _log.warning("a map index cannot be read", extra={"map_id": map_ref.id, "error": str(error)})
            return None


class _RunningQuery:
    """One query in a worker, with its timings and the indexes that are missing."""

    def __init__(self, job: LocalizeJob, localizer: Localizer, settings: WorkerSettings) -> None:
        self._job = job
        self._localizer = localizer
        self._settings = settings
        self._timings_s: dict[str, float] = {}
        self.missing: list[MapRef] = []
        self.index_loads: dict[str, int] = {}

    def answer(self, index_of: Callable[[MapRef], tuple[str, MapIndex | None]]) -> LocalizeOutcome | None:
        """Return the outcome, None when an index is missing. Raises errors of `core`."""
        self._remaining_s()
        maps = self._timed("load", lambda: self._indexes(index_of))
        if self.missing:
            return None
        options = self._job.options
        query = self._timed("decode", self._query)
        localization = self._localizer.localize(
            query,
            maps,
            method=options.method,
            hints=options.hints,
            top_k=options.top_k,
            timeout_s=self._remaining_s(),
        )
        query = as_found(query, localization)
        pictures = self._timed("pictures", lambda: _pictures(query, maps, localization, options.artifacts))
        cells = self._timed("pictures", lambda: _change_cells(maps, localization))
        answer = answer_of(localization, self._job, query.photos, self._timings_s, pictures)
        return LocalizeOutcome(answer, pictures, cells)

    def _indexes(self, index_of: Callable[[MapRef], tuple[str, MapIndex | None]]) -> list[MapIndex]:
        found = []
        for map_ref in self._job.maps:
            source, index = index_of(map_ref)
            self.index_loads[source] = self.index_loads.get(source, 0) + 1
            if index is None:
                self.missing.append(map_ref)
            else:
                found.append(index)
        return found

    def _query(self) -> Rig:
        options = self._job.options
        return read_query(self._job.images, options.frame, options.session, self._settings.max_pixels)

    def _remaining_s(self) -> float:
        remaining_s = self._job.deadline_unix_s - time.time()
        if remaining_s <= 0:
            raise DeadlineExceededError(f"the deadline passed {-remaining_s:.1f} s before a worker could begin")
        return remaining_s

    def _timed(self, stage: str, work: Callable[[], Result]) -> Result:
        began = time.perf_counter()
        result = work()
        self._timings_s[stage] = self._timings_s.get(stage, 0.0) + time.perf_counter() - began
        return result


def _change_cells(maps: Sequence[MapIndex], localization: Localization) -> dict[str, Any] | None:
    best = localization.best
    return None if best is None else change_cells(maps[best.map_position], localization)


def _pictures(
    query: Rig, maps: Sequence[MapIndex], localization: Localization, wanted: Iterable[str]
) -> dict[str, bytes]:
    """Return the PNGs named in `wanted` ("score_map_2d", "score_map_3d", "overlay"); none without a pose."""
    names = tuple(wanted)
    if localization.best is None or not names:
        return {}
    index = maps[localization.best.map_position]
    panorama, localization = shown_on_sphere(query, localization)
    drawn = {}
    if "score_map_2d" in names:
        drawn["score_map_2d"] = draw_score_map_2d(panorama, localization)
    if "score_map_3d" in names or "overlay" in names:
        view = view_scan(index, localization, with_scores="score_map_3d" in names)
        drawn |= {"score_map_3d": draw_score_map_3d(view), "overlay": draw_overlay(panorama, view)}
    # Compression takes a third of the time and releases the GIL.
    with ThreadPoolExecutor(len(names)) as threads:
        return dict(zip(names, threads.map(encode_png, (drawn[name] for name in names)), strict=True))


def build_worker(settings: WorkerSettings) -> LocalizationWorker:
    """Build a worker in the process that will run it."""
    keep_freed_memory()
    use_threads(max(1, num_usable_cpus() // settings.workers_per_machine))
    cache = WorkerCache(settings.redis_url, index_lifetime_s=settings.index_lifetime_s)
    worker = LocalizationWorker(settings, Localizer(), settings.open_storage(), cache)
    gc.collect()
    gc.freeze()  # what stays for good need not be looked through with the garbage of each query
    return worker
