"""The reply of a worker: an outcome or a failure.

Failures travel as values: a process that has not imported a library cannot unpickle its exceptions, and Ray wraps all
of them.
"""

import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import panoloc.core.errors
import panoloc.service.errors
from panoloc.core.errors import CoreError
from panoloc.service.errors import EXPECTED_ERRORS, ServiceError, WorkerError
from panoloc.service.jobs import MapRef

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

    index_loads: how often an index was "resident", came from "redis" or "storage" or was "missing" for this job.
    """

    outcome: Outcome | None = None
    failure: WorkerFailure | None = None
    scores: tuple[float, ...] = ()
    missing: tuple[MapRef, ...] = ()
    worker: str = ""
    duration_s: float = 0.0
    resident_bytes: int = 0
    index_loads: dict[str, int] = field(default_factory=dict)


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
