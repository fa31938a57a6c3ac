"""What a worker has to know, and what it runs, named but not imported: the HTTP process must not load the algorithm.

Both travel with the worker, also to another machine.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from service.jobs import LocalizeJob, LocalizeOutcome, MapRef, RegisterJob, RegisterOutcome
from service.limits.registration_limits import RegistrationLimits
from service.storage import BucketAccess, Storage, open_storage
from service.worker.reply import WorkerReply

if TYPE_CHECKING:
    from service.settings import Settings


@dataclass(frozen=True)
class WorkerSettings:
    """Values that a worker takes from the service's settings.

    redis_url and storage_url: reachable from every machine that runs a worker. bucket: where storage_url names one.
    workers_per_machine: that share its processors. resident_bytes: map indexes kept in memory, least recently used out.
    index_lifetime_s: of an index in Redis after its last use. max_points, max_points_used: of a scan before and after thinning.
    registration_limits: of which the worker keeps those of its process.
    """

    redis_url: str
    storage_url: str
    resident_bytes: int
    max_pixels: int
    max_points: int
    max_points_used: int
    index_lifetime_s: int
    workers_per_machine: int = 1
    registration_limits: RegistrationLimits = field(default_factory=RegistrationLimits)
    bucket: BucketAccess | None = None

    @classmethod
    def of(cls, settings: "Settings", redis_url: str) -> "WorkerSettings":
        """Return what the settings of the service say. redis_url: the one that it uses, which may be its own."""
        return cls(
            redis_url=redis_url,
            storage_url=settings.storage_url,
            resident_bytes=settings.resident_bytes,
            max_pixels=settings.max_pixels,
            max_points=settings.max_points,
            max_points_used=settings.max_points_used,
            index_lifetime_s=settings.index_ttl_s,
            registration_limits=settings.registration_limits,
            bucket=settings.bucket_access,
        )

    def open_storage(self) -> Storage:
        """Return the storage, in the process that will use it."""
        return open_storage(self.storage_url, self.bucket)


class QueryWorker(Protocol):
    """The body of a worker, without Ray."""

    def localize(self, job: LocalizeJob) -> WorkerReply[LocalizeOutcome]:
        """Answer one query."""


class MapRegistrar(Protocol):
    """The body of a registration, without Ray."""

    def register(self, job: RegisterJob) -> WorkerReply[RegisterOutcome]:
        """Build and store the index of one map."""

    def rebuild(self, map_ref: MapRef) -> WorkerReply[None]:
        """Build and store the index of a map whose record and scan are in storage."""


@dataclass(frozen=True)
class WorkerPlan:
    """What workers run: two factories, each "module:function", called with the settings where the work is done."""

    settings: WorkerSettings
    worker: str = "service.worker.localization_worker:build_worker"
    registrar: str = "service.worker.registrar:build_registrar"

    def build_worker(self) -> QueryWorker:
        """Import the factory of query workers and call it."""
        worker: QueryWorker = _imported(self.worker)(self.settings)
        return worker

    def build_registrar(self) -> MapRegistrar:
        """Import the factory of registrars and call it."""
        registrar: MapRegistrar = _imported(self.registrar)(self.settings)
        return registrar


def _imported(factory: str) -> Callable[[WorkerSettings], Any]:
    module, _, name = factory.partition(":")
    found: Callable[[WorkerSettings], Any] = getattr(importlib.import_module(module), name)
    return found
