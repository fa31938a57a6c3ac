"""What runs inside Ray, named but not imported: the HTTP process must not load the algorithm."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from service.jobs import LocalizeJob, LocalizeOutcome, MapRef, RegisterJob, RegisterOutcome
from service.worker.reply import WorkerReply
from service.worker.settings import WorkerSettings


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
    """What runs inside Ray: two factories, each "module:function", called with the settings where the work is done."""

    settings: WorkerSettings
    worker: str = "service.worker.query_worker:build_worker"
    registrar: str = "service.worker.registration:build_registrar"

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
