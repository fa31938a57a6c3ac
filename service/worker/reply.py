"""What comes back from a worker: values, never exceptions, because an exception of `core` cannot be unpickled where
`core` is not imported, and Ray wraps exceptions in classes of its own.
"""

from dataclasses import dataclass, field
from typing import Generic, TypeVar

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
    resident_maps: int = 0
    index_loads: dict[str, int] = field(default_factory=dict)
