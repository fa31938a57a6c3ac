"""What comes back from a worker: values, never exceptions, because an exception of `core` cannot be unpickled where
`core` is not imported, and Ray wraps exceptions in classes of its own.
"""

import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from service import errors
from service.jobs import MapRef

Outcome = TypeVar("Outcome")


@dataclass(frozen=True)
class WorkerFailure:
    """An exception by the name of its class; traceback: only of one that nobody raised on purpose."""

    kind: str
    message: str
    traceback: str = ""


@dataclass(frozen=True)
class WorkerReply(Generic[Outcome]):
    """An outcome, or a failure, or the maps whose index is in Redis no more; and figures about the worker.

    index_loads: how often an index was "resident", came from "redis" or was "missing" for this job.
    """

    outcome: Outcome | None = None
    failure: WorkerFailure | None = None
    missing: tuple[MapRef, ...] = ()
    worker: str = ""
    duration_s: float = 0.0
    resident_bytes: int = 0
    index_loads: dict[str, int] = field(default_factory=dict)


def guarded(work: Callable[[], Outcome]) -> tuple[Outcome | None, WorkerFailure | None]:
    """Return what `work` returns, or what it raised. Nothing passes through but what ends the process."""
    try:
        return work(), None
    except Exception as error:
        origin = "" if _is_raised_on_purpose(error) else traceback.format_exc()
        return None, WorkerFailure(type(error).__name__, str(error), origin)


def error_of(failure: WorkerFailure) -> errors.ServiceError:
    """Return the exception to raise in the HTTP process: one of the service's own by its name, else a WorkerError."""
    if failure.kind == "DeadlineExceededError":
        return errors.DeadlineError(failure.message)
    own = getattr(errors, failure.kind, None)
    if isinstance(own, type) and issubclass(own, errors.ServiceError) and own is not errors.WorkerError:
        return own(failure.message)
    return errors.WorkerError(failure.kind, failure.message)


def _is_raised_on_purpose(error: Exception) -> bool:
    # By the name of the module: the HTTP process imports this one, and must not import `core`.
    return any(each.__module__ in ("core.errors", "service.errors") for each in type(error).__mro__)
