"""A cluster, its serving and their answers as a script says, in place of Ray's processes."""

import asyncio
import threading
from collections.abc import Callable, Generator
from types import SimpleNamespace
from typing import Any

from service.ray.patience import Patience


class Answer:
    """What Ray gives for a call: it is awaited, or cancelled. result: a value, an exception, a future of one, or None for never."""

    def __init__(self, result: Any) -> None:
        self.result = result
        self.is_cancelled = False

    def __await__(self) -> Generator[Any, None, Any]:
        return self._answer().__await__()

    async def _answer(self) -> Any:
        if self.result is None:
            await asyncio.Event().wait()
        if isinstance(self.result, asyncio.Future):
            return await self.result
        if isinstance(self.result, BaseException):
            raise self.result
        return self.result

    def cancel(self) -> None:
        self.is_cancelled = True


class ScriptedCluster:
    """Connects unless it is told to fail; notes what is asked of it, and in which thread."""

    def __init__(self, *failures: Exception) -> None:
        self.failures = list(failures)
        self.failed_rehearsals: list[Exception] = []
        self.asked: list[str] = []
        self.threads: set[str] = set()
        self.is_ours = True
        self.patience = Patience()

    def connect(self) -> None:
        self.patience.begin()
        self._note("connect")
        if self.failures:
            raise self.failures.pop(0)

    def disconnect(self) -> None:
        self._note("disconnect")

    def rehearse(self) -> None:
        self.asked.append("rehearse")
        if self.failed_rehearsals:
            raise self.failed_rehearsals.pop(0)

    def remove_logs_of_ended(self) -> None:
        """Have none."""

    def missing_process(self) -> str | None:
        return None

    def _note(self, what: str) -> None:
        self.asked.append(what)
        self.threads.add(threading.current_thread().name)


class ScriptedServing:
    """Workers that answer one after the other what `answers` says; tasks end with what `tasks` says."""

    def __init__(self, *answers: Any, num_workers: int = 1) -> None:
        self.given: list[Answer] = []
        self.routed_by: list[str] = []
        self.jobs: list[Any] = []
        self.answers = list(answers)
        self.tasks: list[Any] = []
        self.submitted: list[tuple[str, Any]] = []
        self.references: list[Answer] = []
        self.faults: list[list[str]] = []
        self.running: Callable[[], int] = lambda: num_workers
        self.asked: list[str] = []
        self.told = ""
        self.told_load = self.num_exchanges = 0
        self.load_of_others: list[int] = []
        self._num_workers = num_workers

    def options(self, *, multiplexed_model_id: str) -> Any:
        self.routed_by.append(multiplexed_model_id)
        return SimpleNamespace(localize=self)

    def remote(self, job: Any) -> Answer:
        self.jobs.append(job)
        self.given.append(Answer(self.answers.pop(0)))
        return self.given[-1]

    def unreachable(self) -> list[str]:
        self.asked.append("unreachable")
        return self.faults.pop(0) if self.faults else []

    def deploy(self) -> tuple[Any, Any]:
        self.asked.append("deploy")
        return self, SimpleNamespace(num_workers=self._num_workers)

    def follow_machines(self) -> None:
        self.asked.append("follow machines")

    def num_running(self) -> int:
        return self.running()

    def exchange_load(self, num_admitted: int) -> list[int]:
        self.told_load = num_admitted
        self.num_exchanges += 1
        return self.load_of_others

    def submit(self, task: Callable[..., Any], argument: Any) -> Answer:
        self.submitted.append((task.__name__, argument))
        self.references.append(Answer(self.tasks.pop(0)))
        return self.references[-1]

    def retire(self) -> None:
        self.asked.append("retire")
