"""The worker that registers maps: reads the scan, builds its index, puts it into Redis. Runs in a process of its own."""

import contextlib
import dataclasses
import os
import socket
import time
from collections.abc import Callable
from pathlib import PurePosixPath
from typing import TypeVar

import torch

from core.errors import ScanContentError
from core.index.map_builder import build_map_index, index_config_digest
from core.index.map_codec import encode_map_index
from core.index.map_diagnostics import map_diagnostics
from core.index.map_index import MapIndex
from core.options import MIN_POINTS
from core.pictures import draw_map_preview, encode_png
from core.scan.archive.unpacking import remove_remains
from core.scan.point_cloud import PointCloud
from core.scan.reading import read_scan
from core.zip_opening import unpacked_bytes
from service.cache import WorkerCache
from service.errors import CacheDownError, MapNotFoundError, RegistrationLimitError, TryAgainError
from service.host.process_resources import limit_process, num_usable_cpus
from service.jobs import MapRef, RegisterJob, RegisterOutcome
from service.limits.registration_limits import MAX_COUNTED_BYTES
from service.worker.map_catalog import MapCatalog
from service.worker.outcomes import sample_ply, starts_of, stats_of
from service.worker.plan import WorkerSettings
from service.worker.registration_progress import RegistrationProgress
from service.worker.reply import WorkerReply, guarded

Result = TypeVar("Result")

# A Redis that is starting again is worth waiting for: without the index the first query builds it once more.
_REDIS_PATIENCE_S = 10.0


class Registrar:
    """Builds map indexes."""

    def __init__(
        self,
        settings: WorkerSettings,
        catalog: MapCatalog,
        cache: WorkerCache,
        limit_process: Callable[[int, float], None] = lambda num_bytes, cpu_s: None,
    ) -> None:
        """limit_process: gives this process so many bytes and seconds of a processor; for one that ends with its work."""
        self._limit_process = limit_process
        self._settings = settings
        self._catalog = catalog
        self._cache = cache
        self._name = f"{socket.gethostname()}-{os.getpid()}"

    def register(self, job: RegisterJob) -> WorkerReply[RegisterOutcome]:
        """Build and store the index of a new map; report the progress; describe the map."""
        outcome, failure = guarded(lambda: _within_memory(lambda: self._register(job)))
        return WorkerReply(outcome=outcome, failure=failure, worker=self._name)

    def rebuild(self, map_ref: MapRef) -> WorkerReply[None]:
        """Build and store an index that Redis has lost."""
        _, failure = guarded(lambda: _within_memory(lambda: self._rebuild(map_ref)))
        return WorkerReply(failure=failure, worker=self._name)

    def _register(self, job: RegisterJob) -> RegisterOutcome:
        progress = RegistrationProgress(self._cache, job.map)
        cloud, index = self._build(job, progress)
        encoded = encode_map_index(index)
        progress.report("storing", 0.0)
        self._catalog.store_index(job.map, index_config_digest(job.options.index), encoded)
        self._store_patiently(job, encoded)
        diagnostics = (*cloud.diagnostics, *map_diagnostics(index, job.options.index, len(cloud)))
        return RegisterOutcome(
            stats=stats_of(cloud, index, len(encoded), progress.finish()),
            diagnostics=[dataclasses.asdict(found) for found in diagnostics],
            preview_png=encode_png(draw_map_preview(index)),
            points_ply=sample_ply(cloud),
            starts=starts_of(index),
        )

    def _rebuild(self, map_ref: MapRef) -> None:
        job = self._catalog.registration_of(map_ref)
        _, index = self._build(job, RegistrationProgress(None, map_ref))
        encoded = encode_map_index(index)
        self._catalog.store_index(map_ref, index_config_digest(job.options.index), encoded)
        self._store(job, encoded)

    def _build(self, job: RegisterJob, progress: RegistrationProgress) -> tuple[PointCloud, MapIndex]:
        limits = self._settings
        reading = dataclasses.replace(
            job.options.scan,
            max_points=limits.max_points,
            max_points_used=limits.max_points_used,
            format=PurePosixPath(job.scan_name).suffix or None,
            # This process has the token of Ray and the address of Redis.
            from_strangers=True,
        )
        with self._catalog.scan_file(job) as path:
            allowed, scan_bytes = limits.registration_limits, unpacked_bytes(path, MAX_COUNTED_BYTES)
            # The pool looks after the time of a registration; this also ends a rebuild that computes for ever.
            self._limit_process(allowed.bytes(scan_bytes), allowed.seconds(scan_bytes) * num_usable_cpus())
            progress.report("reading", 0.0)
            self._remove_remains()
            cloud = read_scan(
                path, reading, lambda share: progress.report("reading", share), self._catalog.temporary_folder
            )
        if len(cloud) < MIN_POINTS:
            raise ScanContentError(
                f"The scan has {len(cloud):,} points; expected at least {MIN_POINTS}, and thousands for a map that serves. "
                "Export the whole scan."
            )
        return cloud, build_map_index(cloud, job.options.index, progress=progress.report)

    def _remove_remains(self) -> None:
        """Remove what registrations of archives that were killed have left behind."""
        # Where nothing can be written now, maps whose index is lost are built all the same.
        with contextlib.suppress(TryAgainError, OSError):
            remove_remains(self._catalog.temporary_folder())

    def _store(self, job: RegisterJob, encoded: bytes) -> None:
        """Put an index into Redis. Raises MapNotFoundError when its revision was replaced or deleted meanwhile."""
        digest = index_config_digest(job.options.index)
        self._cache.put_index(job.map, digest, encoded)
        try:
            # Afterwards: whoever removes a revision changes its record first and forgets its index last.
            self._catalog.registration_of(job.map)
        except MapNotFoundError:
            self._cache.forget_index(job.map, digest)
            raise

    def _store_patiently(self, job: RegisterJob, encoded: bytes) -> None:
        deadline = time.monotonic() + _REDIS_PATIENCE_S
        while True:
            try:
                return self._store(job, encoded)
            except CacheDownError:
                if time.monotonic() > deadline:
                    return None
                time.sleep(0.5)


def _within_memory(work: Callable[[], Result]) -> Result:
    """Do work. Raises RegistrationLimitError where it finds no memory."""
    try:
        return work()
    except (MemoryError, RuntimeError) as error:
        # torch has no class of its own for this.
        if not isinstance(error, MemoryError) and "can't allocate memory" not in str(error):
            raise
        raise RegistrationLimitError(
            "expected a scan that takes less memory than allowed (PANOLOC_REGISTRATION_MEMORY_BYTES), but there "
            "was none left; thin the scan, or let the operator allow more"
        ) from error


def build_registrar(settings: WorkerSettings) -> Registrar:
    """Build a registrar in the process that will run it."""
    torch.set_num_threads(num_usable_cpus())
    cache = WorkerCache(settings.redis_url, index_lifetime_s=settings.index_lifetime_s)
    return Registrar(settings, MapCatalog(settings.open_storage()), cache, limit_process)
