"""The worker that registers maps: reads the scan, builds the index, stores it in Redis. Runs in its own process."""

import contextlib
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import PurePosixPath
from typing import Any, TypeVar

import numpy as np
import torch

from panoloc.core.decide.pictures import draw_map_preview, encode_png
from panoloc.core.errors import ScanContentError
from panoloc.core.kernels.library import use_threads
from panoloc.core.map.map_builder import build_map_index, index_config_digest
from panoloc.core.map.map_codec import encode_map_index
from panoloc.core.map.map_diagnostics import map_diagnostics
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.retrieval_vectors import encode_retrieval_vectors, retrieval_vectors
from panoloc.core.options import MIN_POINTS
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from panoloc.core.scan.storeys import floors_of
from panoloc.core.scan.unpacking import remove_remains
from panoloc.core.scan.zip_opening import unpacked_bytes
from panoloc.service.cache import WorkerCache
from panoloc.service.errors import CacheDownError, MapNotFoundError, RegistrationLimitError, TryAgainError
from panoloc.service.host.process_resources import limit_process, num_usable_cpus
from panoloc.service.jobs import MAX_SAMPLE_POINTS, MapRef, RegisterJob, RegisterOutcome
from panoloc.service.limits.registration_limits import MAX_COUNTED_BYTES
from panoloc.service.storage import Storage
from panoloc.service.worker.map_catalog import registration_of, store_index, store_vectors
from panoloc.service.worker.plan import WorkerPlan, WorkerReply, guarded

Result = TypeVar("Result")

# Waiting for a Redis that restarts is cheaper than building the index again at the first query.
_REDIS_WAIT_S = 10.0
_REPORT_PERIOD_S = 0.2
# Stages of `panoloc.core.map.map_builder`: name in `stats.seconds`, begin and end on the way from 0 to 1 (in
# furnished rooms).
_STAGES = {
    "reading": ("read", 0.0, 0.2),
    "finding starts": ("starts", 0.2, 0.25),
    "rendering starts": ("render", 0.25, 0.9),
    "describing views": ("describe", 0.9, 0.97),
    "storing": ("store", 0.97, 1.0),
}


class RegistrationProgress:
    """Publishes the stages of a registration in Redis, at most five times a second, and measures them. Works on without Redis."""

    def __init__(self, cache: WorkerCache | None, map_ref: MapRef) -> None:
        """cache: None to measure only."""
        self._cache = cache
        self._map_ref = map_ref
        self._stage: str | None = None
        self._began = self._reported = 0.0
        self._seconds: dict[str, float] = {}

    def report(self, stage: str, share: float) -> None:
        """Publish that `share` (0 to 1) of `stage` is done."""
        if stage != self._stage:
            self.finish()
            self._stage, self._began = stage, time.monotonic()
        elif time.monotonic() - self._reported < _REPORT_PERIOD_S:
            return
        self._reported = time.monotonic()
        if self._cache is not None:
            _, begin, end = _STAGES[stage]
            status = "reading" if stage == "reading" else "indexing"
            with contextlib.suppress(CacheDownError):
                self._cache.report_progress(self._map_ref, status, stage, begin + (end - begin) * share)

    def finish(self) -> dict[str, float]:
        """End the stage under way, and return the seconds of every stage."""
        if self._stage is not None:
            name, _, _ = _STAGES[self._stage]
            self._seconds[name] = self._seconds.get(name, 0.0) + time.monotonic() - self._began
        self._stage = None
        return self._seconds


@dataclass
class Registrar:
    """Builds map indexes. limit_process: limits bytes of memory and seconds of CPU time of this process, which ends with its work."""

    plan: WorkerPlan
    storage: Storage
    cache: WorkerCache
    limit_process: Callable[[int, float], None] = lambda num_bytes, cpu_s: None

    def register(self, job: RegisterJob) -> WorkerReply[RegisterOutcome]:
        """Build and store the index of a new map, and report the progress."""
        return WorkerReply(*guarded(lambda: _within_memory(lambda: self._register(job))))

    def rebuild(self, map_ref: MapRef) -> WorkerReply[None]:
        """Build and store an index again that Redis has lost."""
        return WorkerReply(*guarded(lambda: _within_memory(lambda: self._rebuild(map_ref))))

    def _register(self, job: RegisterJob) -> RegisterOutcome:
        progress = RegistrationProgress(self.cache, job.map)
        cloud, index, encoded = self._build(job, progress)
        self._store_with_retries(job, encoded)
        diagnostics = (*cloud.diagnostics, *map_diagnostics(index, job.options.index, len(cloud)))
        return RegisterOutcome(
            stats=_stats(cloud, index, len(encoded), progress.finish()),
            diagnostics=[asdict(found) for found in diagnostics],
            preview_png=encode_png(draw_map_preview(index)),
            points_ply=_sample_ply(cloud),
            starts=_starts(index),
        )

    def _rebuild(self, map_ref: MapRef) -> None:
        job = registration_of(self.storage, map_ref)
        _, _, encoded = self._build(job, RegistrationProgress(None, map_ref))
        self._store(job, encoded)

    def _build(self, job: RegisterJob, progress: RegistrationProgress) -> tuple[PointCloud, MapIndex, bytes]:
        """Return the cloud of a scan, its index, and the index encoded, of which a copy is in storage then."""
        plan = self.plan
        reading = replace(
            job.options.scan,
            max_points=plan.max_points,
            max_points_used=plan.max_points_used,
            format=PurePosixPath(job.scan_name).suffix or None,
            # Parsed in a sandbox: this process holds the address of Redis.
            from_strangers=True,
        )
        with self.storage.local_copy(job.scan_key) as path:
            allowed, scan_bytes = plan.registration_limits, unpacked_bytes(path, MAX_COUNTED_BYTES)
            # The pool ends a registration that takes too long; this also ends an endless rebuild.
            self.limit_process(allowed.bytes(scan_bytes), allowed.seconds(scan_bytes) * num_usable_cpus())
            progress.report("reading", 0.0)
            self._remove_remains()
            # Archives are unpacked on the disk of the scans: the system's own folder for that may be in memory.
            unpacking = self.storage.spool_folder
            cloud = read_scan(path, reading, lambda share: progress.report("reading", share), unpacking)
        if len(cloud) < MIN_POINTS:
            raise ScanContentError(
                f"The scan has too few points: expected at least {MIN_POINTS}, and tens of thousands for good poses, got "
                f"{len(cloud):,}. Export the whole scan."
            )
        index = build_map_index(cloud, job.options.index, progress=progress.report)
        encoded = encode_map_index(index)
        progress.report("storing", 0.0)
        store_vectors(self.storage, job.map, encode_retrieval_vectors(retrieval_vectors(index)))
        store_index(self.storage, job.map, index_config_digest(job.options.index), encoded)
        return cloud, index, encoded

    def _remove_remains(self) -> None:
        """Remove unpacked archives that killed registrations have left."""
        # A read-only storage must not stop a rebuild.
        with contextlib.suppress(TryAgainError, OSError):
            remove_remains(self.storage.spool_folder())

    def _store(self, job: RegisterJob, encoded: bytes) -> None:
        """Put an index into Redis. Raises MapNotFoundError when its revision was replaced or deleted meanwhile."""
        digest = index_config_digest(job.options.index)
        self.cache.put_index(job.map, digest, encoded)
        try:
            # After the write: a deletion changes the record first and removes the index last.
            registration_of(self.storage, job.map)
        except MapNotFoundError:
            self.cache.forget_index(job.map, digest)
            raise

    def _store_with_retries(self, job: RegisterJob, encoded: bytes) -> None:
        deadline = time.monotonic() + _REDIS_WAIT_S
        while True:
            try:
                return self._store(job, encoded)
            except CacheDownError:
                if time.monotonic() > deadline:
                    return None
                time.sleep(0.5)


def _stats(cloud: PointCloud, index: MapIndex, index_bytes: int, seconds: dict[str, float]) -> dict[str, Any]:
    """Return `stats` of a map as the HTTP contract promises them, positions in the scan's own frame, metres."""
    lower, upper = index.bounds
    return {
        "num_points": cloud.num_points_read or len(cloud),
        "num_points_used": index.num_points,
        "bounds": {"min": lower.tolist(), "max": upper.tolist()},
        "origin_offset": index.origin_offset.tolist(),
        "num_starts": index.num_starts,
        "index_bytes": index_bytes,
        "seconds": seconds,
        "coordinate_system": cloud.coordinate_system,
        "read_as": None if cloud.read_as is None else asdict(cloud.read_as),
        "floors": _floors(cloud),
    }


def _floors(cloud: PointCloud) -> list[dict[str, Any]]:
    """Return the floors of a scan, bottom up, metres, in the scan's own frame."""
    found = (asdict(floor) for floor in floors_of(cloud.positions))
    return [{**floor, "level_m": floor["level_m"] + float(cloud.origin_offset[2])} for floor in found]


def _starts(index: MapIndex) -> list[dict[str, Any]]:
    """Return position and leaf size of every start, metres, in the scan's own frame."""
    return [
        {"position_m": position, "leaf_size_m": size}
        for position, size in zip(index.start_positions.tolist(), index.leaf_sizes.tolist(), strict=True)
    ]


def _sample_ply(cloud: PointCloud) -> bytes:
    """Return at most MAX_SAMPLE_POINTS coloured points as a binary PLY, shuffled: every prefix is a fair sample."""
    chosen = np.random.default_rng(0).permutation(len(cloud))[:MAX_SAMPLE_POINTS]
    sample = replace(cloud, positions=cloud.positions[chosen], colors=cloud.colors[chosen])
    return encode_ply(sample)


def _within_memory(work: Callable[[], Result]) -> Result:
    """Return the result of `work`. Raises RegistrationLimitError when memory runs out."""
    try:
        return work()
    except (MemoryError, RuntimeError) as error:
        # torch raises a plain RuntimeError.
        if not isinstance(error, MemoryError) and "can't allocate memory" not in str(error):
            raise
        raise RegistrationLimitError(
            "expected a scan that fits in the allowed memory (PANOLOC_REGISTRATION_MEMORY_BYTES), but the memory ran "
            "out; thin the scan, or ask the operator for more"
        ) from error


def build_registrar(plan: WorkerPlan) -> Registrar:
    """Build a registrar in the process that will run it."""
    use_threads(num_usable_cpus())
    torch.set_num_threads(num_usable_cpus())  # operations of a registration are large enough for several
    cache = WorkerCache(plan.redis_url, index_lifetime_s=plan.index_lifetime_s)
    return Registrar(plan, plan.open_storage(), cache, limit_process)
