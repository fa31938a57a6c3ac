"""Turns the exceptions of a worker into values, by the names of their classes."""

import traceback
from collections.abc import Callable
from typing import TypeVar

import redis

from service.worker_reply import WorkerFailure

Outcome = TypeVar("Outcome")


def guarded(work: Callable[[], Outcome]) -> tuple[Outcome | None, WorkerFailure | None]:
    """Return what `work` returns, or what it raised. Nothing passes through but what ends the process."""
    try:
        return work(), None
    except redis.RedisError as error:
        return None, WorkerFailure("CacheUnavailableError", f"a worker cannot reach Redis: {error}")
    except Exception as error:
        return None, WorkerFailure(type(error).__name__, str(error), traceback.format_exc())
