"""The worker that answers queries: decodes the images, localizes them in the maps of the query, draws the pictures."""

import gc
import logging
import os
import socket
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from panoloc.core.camera.rig import Rig
from panoloc.core.decide.pictures import (
    Picture,
    draw_overlay,
    draw_score_map_2d,
    draw_score_map_3d,
    encode_png,
    view_scan,
)
from panoloc.core.errors import DeadlineExceededError
from panoloc.core.kernels.library import use_threads
from panoloc.core.localizer import Localizer
from panoloc.core.many_maps import localize_among, scores_among, view_from
from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Candidate, Localization
from panoloc.service.cache import WorkerCache
from panoloc.service.host.process_resources import keep_freed_memory, num_usable_cpus
from panoloc.service.jobs import LocalizeJob, LocalizeOutcome, MapRef
from panoloc.service.storage import Storage
from panoloc.service.worker.answers import answer_of, change_cells, change_photo
from panoloc.service.worker.plan import WorkerPlan, WorkerReply, guarded
from panoloc.service.worker.query_images import as_found, read_query, shown_on_sphere
from panoloc.service.worker.shelf import MissingIndexError, QueryMaps, Shelf

_log = logging.getLogger(__name__)
Result = TypeVar("Result")


class LocalizationWorker:
    """Holds a localizer and the maps used last. Computes one query at a time."""

    def __init__(self, plan: WorkerPlan, localizer: Localizer, storage: Storage, cache: WorkerCache) -> None:
        self._plan = plan
        self._localizer = localizer
        self._shelf = Shelf(storage, cache, str(localizer.device), plan.resident_bytes)
        self._name = f"{socket.gethostname()}-{os.getpid()}"

    def localize(
        self, job: LocalizeJob, is_cancelled: Callable[[], bool] = lambda: False
    ) -> WorkerReply[LocalizeOutcome]:
        """Answer one query, or score the maps of a share of it, or name the indexes that have to be built again first."""
        began = time.monotonic()
        maps = QueryMaps(self._shelf, job.maps)
        query = _RunningQuery(job, maps, self._localizer, self._plan.max_pixels, is_cancelled)
        outcome, failure = guarded(query.answer)
        return WorkerReply(
            outcome=outcome,
            failure=failure,
            scores=query.scores,
            view=query.view,
            missing=query.missing,
            worker=self._name,
            duration_s=time.monotonic() - began,
            resident_bytes=self._shelf.num_bytes,
            index_loads=dict(query.maps.loads),
        )


@dataclass
class _RunningQuery:
    """One query in a worker, with its timings and the indexes that are missing."""

    job: LocalizeJob
    maps: QueryMaps
    localizer: Localizer
    max_pixels: int
    is_cancelled: Callable[[], bool]
    timings_s: dict[str, float] = field(default_factory=dict)
    missing: tuple[MapRef, ...] = ()
    scores: tuple[float, ...] = ()
    view: bytes = b""

    def answer(self) -> LocalizeOutcome | None:
        """Return the outcome; None when an index is missing, or only scores are asked for. Raises errors of `core`."""
        self._remaining_s()
        images, wanted = self.job.images, self.job.options
        query = self._timed("decode", lambda: read_query(images, wanted.frame, wanted.session, self.max_pixels))
        try:
            if self.job.share is not None:
                vectors = self.maps.vectors()
                along_walls = self.job.along_walls
                self.scores = tuple(scores_among(self.localizer, query, vectors, wanted.hints, along_walls=along_walls))
                return None
            localization = self._localized(query)
        except MissingIndexError as error:
            self.missing = error.refs
            return None
        query = as_found(query, localization)
        index = None if localization.best is None else self.maps.searched[localization.best.map_position]
        if self.job.num_maps is not None and localization.best is not None and localization.status == "localized":
            # Nobody here knows all maps of the query.
            self.view = encode_png(self._view(localization.best))
        pictures = self._timed("pictures", lambda: _pictures(query, index, localization, wanted.artifacts))
        cells = self._timed("pictures", lambda: None if index is None else change_cells(index, localization))
        answer = answer_of(localization, self.job, query.photos, self.timings_s, pictures)
        photo = self._timed("pictures", lambda: change_photo(query, localization)) if self.job.keep_photo else None
        return LocalizeOutcome(answer, pictures, cells, photo)

    def _localized(self, query: Rig) -> Localization:
        options = self.job.options
        return localize_among(
            self.localizer,
            query,
            self.maps,
            method=options.method,
            hints=options.hints,
            top_k=options.top_k,
            timeout_s=self._remaining_s(),
            num_maps=self.job.num_maps,
            is_cancelled=self.is_cancelled,
        )

    def _view(self, best: Candidate) -> Picture:
        """Return what its map shows around a pose, transparent where that is nothing."""
        rows = 2 * self.localizer.config.descriptors.view_height
        (photo,) = view_from(self.maps.searched[best.map_position], best.pose, rows).photos
        return np.dstack((photo.color, 255 * photo.valid.astype(np.uint8)))

    def _remaining_s(self) -> float:
        remaining_s = self.job.deadline_unix_s - time.time()
        if remaining_s <= 0:
            raise DeadlineExceededError(f"the deadline passed {-remaining_s:.1f} s before a worker could begin")
        return remaining_s

    def _timed(self, stage: str, work: Callable[[], Result]) -> Result:
        began = time.perf_counter()
        result = work()
        self.timings_s[stage] = self.timings_s.get(stage, 0.0) + time.perf_counter() - began
        return result


def _pictures(
    query: Rig, index: MapIndex | None, localization: Localization, wanted: Iterable[str]
) -> dict[str, bytes]:
    """Return the PNGs named in `wanted` ("score_map_2d", "score_map_3d", "overlay"); none without a pose in a map."""
    names = tuple(wanted)
    if index is None or not names:
        return {}
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


def build_worker(plan: WorkerPlan) -> LocalizationWorker:
    """Build a worker in the process that will run it."""
    keep_freed_memory()
    use_threads(max(1, num_usable_cpus() // plan.workers_per_machine))
    cache = WorkerCache(plan.redis_url, index_lifetime_s=plan.index_lifetime_s)
    worker = LocalizationWorker(plan, Localizer(), plan.open_storage(), cache)
    gc.collect()
    gc.freeze()  # what stays for good need not be looked through with the garbage of each query
    return worker
