"""Turns the exceptions of a worker into values, and on the other side into exceptions of the service."""

import traceback
from collections.abc import Callable
from typing import TypeVar

from service import errors
from service.worker.reply import WorkerFailure

Outcome = TypeVar("Outcome")


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
