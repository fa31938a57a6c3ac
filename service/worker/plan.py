"""The plan of a worker: its settings, and what it runs, by name, for the HTTP process must not import the algorithm; and its reply: an
outcome or a failure.

Failures travel as values: a process that has not imported a library cannot unpickle its exceptions, and Ray wraps all of them.
"""

import pkgutil
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, Literal, Protocol, TypeVar

import panoloc.core.errors
import panoloc.service.errors
from panoloc.core.errors import CoreError
from panoloc.service.errors import EXPECTED_ERRORS, ServiceError, WorkerError
from panoloc.service.jobs import LocalizeJob, LocalizeOutcome, MapRef, RegisterJob, RegisterOutcome
from panoloc.service.limits.registration_limits import RegistrationLimits
from panoloc.service.storage import BucketAccess, Storage, open_storage

if TYPE_CHECKING:
    from panoloc.service.settings import Settings

Outcome = TypeVar("Outcome")


@dataclass(frozen=True)
class WorkerFailure:
    """An exception by the name of its class. traceback: of unexpected ones only."""

    kind: str
    message: str
    traceback: str = ""


@dataclass(frozen=True)
class WorkerReply(Generic[Outcome]):
    """An outcome, a failure, the scores of a share of maps, or the maps whose index has to be built again; and figures about the worker.

    view: of a place that was found in one of many maps, what the map shows all around, as PNG; others may look the same.
    index_loads: how often an index was "resident", came from "redis" or "storage" or was "missing" for this job.
    """

    outcome: Outcome | None = None
    failure: WorkerFailure | None = None
    scores: tuple[float, ...] = ()
    view: bytes = b""
    missing: tuple[MapRef, ...] = ()
    worker: str = ""
    duration_s: float = 0.0
    resident_bytes: int = 0
    index_loads: dict[str, int] = field(default_factory=dict)


class QueryWorker(Protocol):
    """What a pool runs in a worker."""

    def localize(
        self, job: LocalizeJob, is_cancelled: Callable[[], bool] = lambda: False
    ) -> WorkerReply[LocalizeOutcome]:
        """Answer one query. is_cancelled: tells, at any time, whether nobody waits for it any more."""


class MapRegistrar(Protocol):
    """What a pool runs for a registration."""

    def register(self, job: RegisterJob) -> WorkerReply[RegisterOutcome]:
        """Build and store the index of one map."""

    def rebuild(self, map_ref: MapRef) -> WorkerReply[None]:
        """Build and store the index of a map whose record and scan are in storage."""


@dataclass(frozen=True)
class WorkerPlan:
    """What workers run, and the service's settings that they need. It is pickled and may travel to another machine.

    redis_url, storage_url: reachable from every machine that runs a worker. bucket: access to the one that storage_url
    names. workers_per_machine: they share its processors. resident_bytes: of map indexes in memory. index_lifetime_s:
    of an index in Redis after its last use. max_points, max_points_used: of a scan before and after thinning.
    registration_limits: the worker sets those of its own process. log: level and format. worker, registrar: two factories,
    "module:function", called with the plan in the worker's process.
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
    log: tuple[str, Literal["console", "json"]] = ("info", "console")
    worker: str = "panoloc.service.worker.localization_worker:build_worker"
    registrar: str = "panoloc.service.worker.registrar:build_registrar"

    @classmethod
    def of(cls, settings: "Settings", redis_url: str) -> "WorkerPlan":
        """Return the plan by the settings. redis_url: of the Redis in use, which may be embedded."""
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
            log=(settings.log_level, settings.log_format),
        )

    def open_storage(self) -> Storage:
        """Open the storage, in the process that will use it."""
        return open_storage(self.storage_url, self.bucket)

    @property
    def modules(self) -> set[str]:
        """Return what workers and registrars import, which takes most of the time of their start."""
        return {self.worker.partition(":")[0], self.registrar.partition(":")[0]}

    def build_worker(self) -> QueryWorker:
        """Import the factory of query workers and call it."""
        worker: QueryWorker = pkgutil.resolve_name(self.worker)(self)
        return worker

    def build_registrar(self) -> MapRegistrar:
        """Import the factory of registrars and call it."""
        registrar: MapRegistrar = pkgutil.resolve_name(self.registrar)(self)
        return registrar


def guarded(work: Callable[[], Outcome]) -> tuple[Outcome | None, WorkerFailure | None]:
    """Return the result of `work`, or the exception that it raised. KeyboardInterrupt and SystemExit pass through."""
    try:
        return work(), None
    except Exception as error:
        return None, failure_of(error)


def failure_of(error: Exception) -> WorkerFailure:
    """Return an exception as a value."""
    origin = "" if isinstance(error, EXPECTED_ERRORS) else "".join(traceback.format_exception(error))
    return WorkerFailure(type(error).__name__, str(error), origin)


def error_of(failure: WorkerFailure) -> ServiceError | CoreError:
    """Return the exception to raise in the HTTP process: the same expected one, else a WorkerError."""
    for module in (panoloc.core.errors, panoloc.service.errors):
        found = getattr(module, failure.kind, None)
        if isinstance(found, type) and issubclass(found, EXPECTED_ERRORS) and found is not WorkerError:
            return found(failure.message)
    return WorkerError(failure.kind, failure.message)
