"""Everything that routes work with, put together once per application."""

import asyncio
import time
from dataclasses import dataclass, field

from starlette.requests import HTTPConnection

from panoloc.service.batches.runs import BatchRuns
from panoloc.service.batches.store import MOST_BATCHES, BatchStore
from panoloc.service.cache import Cache
from panoloc.service.host.demo_room import DemoRoom
from panoloc.service.host.redis_watch import watch_redis
from panoloc.service.jobs import WorkerPool
from panoloc.service.keys.audit_log import AuditLog
from panoloc.service.limits.caller_rates import CallerRates, RateLimits
from panoloc.service.limits.capacity import Capacity, bytes_in_flight, upload_places
from panoloc.service.limits.wrong_keys import WrongKeys
from panoloc.service.localizations import Localizations
from panoloc.service.maps.changes import ChangeLog
from panoloc.service.maps.registrations import Registrations
from panoloc.service.maps.registry import MapRegistry
from panoloc.service.metrics import Metrics
from panoloc.service.settings import Settings
from panoloc.service.shared_folder import LOOK_S, SharedFolder
from panoloc.service.sharing.change_signal import ChangeSignal
from panoloc.service.sharing.leases import LeaseLocks
from panoloc.service.sharing.locks import FolderLocks, Locks, OwnLocks
from panoloc.service.storage import Storage

_MOST_EXPORTS = 2
# A list of a bucket costs time and money; what was changed is told by Redis, which several front doors on a bucket cannot do without.
_LOOK_INTO_BUCKET_S = 15.0


@dataclass
class Services:
    """The collaborators of one application.

    shared_folder: None without other front doors. started: whether start-up is over, so that requests can be served. began: monotonic
    seconds. export_turns: held while an export is written, which takes a process of its own and much of a processor.
    """

    settings: Settings
    pool: WorkerPool
    cache: Cache
    storage: Storage
    registry: MapRegistry
    metrics: Metrics
    registrations: Registrations
    localizations: Localizations
    changes: ChangeLog
    demo_room: DemoRoom
    batches: BatchStore
    batch_runs: BatchRuns
    bytes_in_flight: Capacity
    rates: CallerRates
    uploads: Capacity
    wrong_keys: WrongKeys
    audit: AuditLog
    locks: Locks
    shared_folder: SharedFolder | None = None
    started: bool = False
    began: float = field(default_factory=time.monotonic)
    export_turns: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(_MOST_EXPORTS))
    _watch: asyncio.Task[None] | None = None
    _issuer_keys: asyncio.Task[None] | None = None

    @classmethod
    def build(cls, settings: Settings, pool: WorkerPool, cache: Cache, storage: Storage) -> "Services":
        """Put the services of an application together; nothing runs before `start`."""
        locks = _locks_of(settings)
        registry = MapRegistry(storage, settings.max_maps, locks)
        metrics = Metrics(pool.state, registry.num_by_status)
        changes = ChangeLog(storage)
        localizations = Localizations(settings, registry, pool, cache, storage, metrics, changes)
        batches = BatchStore(storage, MOST_BATCHES, locks)
        batch_runs = BatchRuns(batches, localizations, pool, settings.max_pixels)
        registrations = Registrations(registry, pool, cache, metrics, settings.registration_limits)
        shared_folder = None
        if settings.shared:
            assert settings.redis_url is not None
            signal = ChangeSignal(settings.redis_url)
            look_s = _LOOK_INTO_BUCKET_S if settings.has_bucket else LOOK_S
            shared_folder = SharedFolder(storage, registry, registrations, batches, batch_runs, signal, look_s)
        return cls(
            settings,
            pool,
            cache,
            storage,
            registry,
            metrics,
            registrations,
            localizations,
            changes,
            DemoRoom(storage),
            batches,
            batch_runs,
            bytes_in_flight(settings.max_image_bytes, metrics.note_refusal),
            CallerRates(
                settings.redis_url,
                RateLimits(settings.max_requests_per_minute, settings.max_bytes_per_hour),
                metrics.note_refusal,
            ),
            upload_places(metrics.note_refusal, metrics.note_num_uploads),
            WrongKeys(),
            AuditLog(settings.data_dir),
            locks,
            shared_folder,
        )

    async def start(self) -> None:
        """Read maps and batches, begin to bring the workers up, and take up unfinished registrations and batches."""
        await self.registry.load()
        await self.batches.load()
        await self.pool.start()
        self.registrations.resume()
        self.batch_runs.resume()
        if self.shared_folder is not None:
            self.shared_folder.start()
        if self.settings.redis_url is not None:
            self._watch = asyncio.create_task(watch_redis(self.cache, self.settings.redis_url))
        if (tokens := self.settings.keys.tokens) is not None:
            self._issuer_keys = asyncio.create_task(tokens.keys.follow())
        self.started = True

    async def stop(self) -> None:
        """Let queries end within the drain time, then stop everything."""
        deadline = time.monotonic() + self.settings.drain_s
        for task in (self._watch, self._issuer_keys):
            if task is not None:
                task.cancel()
        if self.shared_folder is not None:
            await self.shared_folder.stop()
        await self.registrations.stop()
        await self.batch_runs.stop()
        await self.localizations.stop(self.settings.drain_s)
        await self.pool.stop(max(0.0, deadline - time.monotonic()))
        await self.cache.close()
        await self.rates.close()
        if self.shared_folder is not None:
            await self.shared_folder.close()
        await self.locks.close()


def _locks_of(settings: Settings) -> Locks:
    if not settings.shared:
        return OwnLocks()
    if settings.has_bucket:
        assert settings.redis_url is not None
        return LeaseLocks(settings.redis_url)
    return FolderLocks(settings.storage_folder / "locks")


def services_of(connection: HTTPConnection) -> Services:
    """Return the services of the application that a request came to."""
    found: Services = connection.app.state.services
    return found
