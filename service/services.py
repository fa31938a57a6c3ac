"""Everything that routes work with, put together once per application."""

import asyncio
import time

from starlette.requests import HTTPConnection

from panoloc.service.batches.runs import BatchRuns
from panoloc.service.batches.store import MOST_BATCHES, BatchStore
from panoloc.service.cache import Cache
from panoloc.service.host.demo_room import DemoRoom
from panoloc.service.host.redis_watch import watch_redis
from panoloc.service.jobs import WorkerPool
from panoloc.service.keys.audit_log import AuditLog
from panoloc.service.limits.caller_rates import CallerRates, WrongKeys
from panoloc.service.limits.capacity import bytes_in_flight, upload_places
from panoloc.service.localizations import Localizations
from panoloc.service.maps.changed_objects import ChangedObjects
from panoloc.service.maps.changes import ChangeLog
from panoloc.service.maps.control import ControlBook
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
# A list of a bucket costs time and money; Redis, which several API replicas need anyway, publishes what has changed.
_LOOK_INTO_BUCKET_S = 15.0


class Services:
    """The collaborators of one application; nothing runs before `start`.

    shared_folder: None without other API replicas. began: monotonic seconds. export_turns: held while an export is
    written, which takes a process of its own and much of a processor.
    """

    def __init__(self, settings: Settings, pool: WorkerPool, cache: Cache, storage: Storage) -> None:
        self.settings, self.pool, self.cache, self.storage = settings, pool, cache, storage
        self.began = time.monotonic()
        self.locks = _locks_of(settings)
        self.registry = MapRegistry(storage, settings.max_maps, self.locks)
        self.metrics = Metrics(pool.state, self.registry.num_by_status)
        self.changes = ChangeLog(storage)
        self.control = ControlBook(storage)
        self.localizations = Localizations(settings, self.registry, pool, cache, storage, self.metrics, self.changes)
        self.batches = BatchStore(storage, MOST_BATCHES, self.locks)
        self.batch_runs = BatchRuns(self.batches, self.localizations, pool, settings.max_pixels)
        self.registrations = Registrations(self.registry, pool, cache, self.metrics, settings.registration_limits)
        self.demo_room = DemoRoom(storage)
        refuse = self.metrics.note_refusal
        self.bytes_in_flight = bytes_in_flight(settings.max_image_bytes, refuse)
        self.uploads = upload_places(refuse, self.metrics.uploads.set)
        limits = settings.max_requests_per_minute, settings.max_bytes_per_hour
        self.rates = CallerRates(settings.redis_url, *limits, refuse)
        self.wrong_keys = WrongKeys()
        self.audit = AuditLog(settings.data_dir)
        self.export_turns = asyncio.Semaphore(_MOST_EXPORTS)
        self.changed_objects = ChangedObjects(storage, self.export_turns)
        self.shared_folder: SharedFolder | None = None
        if settings.shared:
            assert settings.redis_url is not None
            signal = ChangeSignal(settings.redis_url)
            look_s = _LOOK_INTO_BUCKET_S if settings.has_bucket else LOOK_S
            self.shared_folder = SharedFolder(
                storage, self.registry, self.registrations, self.batches, self.batch_runs, signal, look_s
            )
        self._tasks: list[asyncio.Task[None]] = []
        self._drain_ends_at: float | None = None

    @property
    def num_under_way(self) -> int:
        """Return the number of queries that wait or run."""
        return self.pool.num_under_way

    def begin_drain(self) -> None:
        """Refuse new queries from now on; those under way have the drain time from now on."""
        self._drain_ends_at = time.monotonic() + self.settings.drain_s
        self.pool.begin_drain()

    async def is_there(self, path: str) -> bool:
        """Return whether a path in `Location` or `Content-Location` leads to a map, a batch, or a query that has not failed."""
        kind, _, name = path.strip("/").partition("/")
        if kind == "maps":
            await self.registry.find([name])
            return self.registry.has(name)
        if kind == "batches":
            await self.batches.find(name)
            return self.batches.has(name)
        found = await self.cache.get_localization(name)
        return found is not None and found["status"] != "failed"

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
            self._tasks.append(asyncio.create_task(watch_redis(self.cache, self.settings.redis_url)))
        if (tokens := self.settings.keys.tokens) is not None:
            self._tasks.append(asyncio.create_task(tokens.keys.follow()))

    async def stop(self) -> None:
        """Let queries end within the drain time, which may have begun before, then stop everything."""
        deadline = self._drain_ends_at or time.monotonic() + self.settings.drain_s
        for task in self._tasks:
            task.cancel()
        if self.shared_folder is not None:
            await self.shared_folder.stop()
        await self.registrations.stop()
        await self.batch_runs.stop()
        await self.localizations.stop(max(0.0, deadline - time.monotonic()))
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
