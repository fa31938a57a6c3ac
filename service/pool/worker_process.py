"""One child process of the service and the requests that it works on. Used from one event loop."""

import asyncio
import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from panoloc.service.errors import NoWorkerError
from panoloc.service.host.process_resources import SPINNING
from panoloc.service.jobs import LocalizeJob, MapRef
from panoloc.service.pool.messages import Answer, Hello, Kind, Request, Status, packed, received
from panoloc.service.worker.reply import WorkerReply

_MAX_ATTEMPTS = 4
_BUFFER_BYTES = 1 << 20
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
# A search checks its deadline often. One that is this late hangs in native code.
OVERDUE_S = 60.0
# glibc keeps freed panoramas in up to eight heaps per core otherwise.
_ENVIRONMENT = {"MALLOC_ARENA_MAX": "2", **SPINNING}


class Work:
    """A request on its way through the pool. future: its reply, or NoWorkerError."""

    def __init__(self, number: int, kind: Kind, job: Any) -> None:
        self.request = Request(number, kind, job)
        self.future: asyncio.Future[WorkerReply[Any]] = asyncio.get_running_loop().create_future()
        self.num_attempts = 0
        self.begun_s = 0.0

    def __lt__(self, other: "Work") -> bool:
        return self.request.number < other.request.number

    @property
    def maps(self) -> frozenset[MapRef]:
        """Return the maps whose indexes a worker needs for it."""
        return frozenset(self.request.job.maps) if isinstance(self.request.job, LocalizeJob) else frozenset()

    def again(self) -> "Work":
        """Return the same query with a new future and the same place in the queue."""
        return Work(self.request.number, self.request.kind, self.request.job)

    def may_repeat(self, how: str) -> bool:
        """Record that its worker was lost; return whether to ask another one. A query changes nothing, so it is repeated, a few times.

        Where it is not repeated, its future fails.
        """
        self.num_attempts += 1
        if self.request.kind == "localize" and self.num_attempts < _MAX_ATTEMPTS:
            return not self.future.done()
        self.fail(f"{self.num_attempts} workers in a row were lost while answering this query ({how})")
        return False

    def fail(self, reason: str) -> None:
        """Let the waiting call raise NoWorkerError."""
        if not self.future.done():
            self.future.set_exception(NoWorkerError(reason))


class WorkerProcess:
    """A process started with a fresh interpreter. It ends when the service ends: its input is a pipe that the kernel then closes.

    capacity: requests that it takes at a time, 0 until it is ready. num_workers: workers that it stands for. problem: why there are none.
    was_ready: whether it was ready when it ended. under_way: what it works on. known_maps: maps that it has answered for.
    """

    def __init__(
        self,
        module: str,
        hello: Hello,
        on_change: Callable[[], None] = lambda: None,
        on_loss: Callable[[Work, str], None] = lambda work, how: None,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        """module, with its arguments: what to run. variables: for its environment.

        on_change: called after each message. on_loss: called with a request whose worker was lost, and how.
        """
        self._command = [sys.executable, "-P", "-m", *module.split()]
        self._hello = hello
        self._on_change = on_change
        self._on_loss = on_loss
        self._environment = _ENVIRONMENT | dict(os.environ) | dict(variables or {})
        self._environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
        self._process: asyncio.subprocess.Process | None = None
        self._killed_for = ""
        self.capacity = 0
        self.num_workers = 0
        self.problem = ""
        self.was_ready = False
        self.under_way: dict[int, Work] = {}
        self.known_maps: set[MapRef] = set()

    async def run(self) -> str:
        """Start the process, take its messages until it ends, and return how it ended. Cancelling the call kills it."""
        # A session of its own: a terminal's interrupt is for the service, which lets the work under way end.
        process = self._process = await asyncio.create_subprocess_exec(
            *self._command, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, env=self._environment,
            start_new_session=True, limit=_BUFFER_BYTES,
        )  # fmt: skip
        try:
            self._write(self._hello)
            for work in self.under_way.values():
                self._write(work.request)
            await self._take_messages(process)
        finally:
            self.was_ready = self.capacity > 0
            self.capacity = self.num_workers = 0
            self.kill()
            code = await process.wait()
            how = self._killed_for or (signal.Signals(-code).name if code < 0 else f"exit code {code}")
            while self.under_way:
                self._on_loss(self.under_way.popitem()[1], how)
        return how

    def begin(self, work: Work) -> None:
        """Send a request; its reply comes into its future."""
        work.begun_s = time.monotonic()
        self.under_way[work.request.number] = work
        self.known_maps |= work.maps
        if self._process is not None:
            self._write(work.request)

    def cancel(self, work: Work) -> None:
        """Let the process drop a request that nobody waits for."""
        self._write(Request(work.request.number, "cancel", None))

    def kill(self, reason: str = "") -> None:
        """End the process, whatever it is doing. reason: what `run` returns then."""
        self._killed_for = self._killed_for or reason
        if self._process is not None and self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()

    def end_if_astray(self, memory_bytes: int) -> None:
        """Kill the process when it hangs or has more memory than it may. memory_bytes: resident memory that it may have."""
        due = [work.request.job.deadline_unix_s for work in self.under_way.values() if work.request.kind == "localize"]
        if due and time.time() > min(due) + OVERDUE_S:
            self.kill(f"a query was {OVERDUE_S:.0f} s past its deadline")
        elif self._resident_bytes() > memory_bytes:
            self.kill(f"it used more than {memory_bytes / 2**30:.1f} GiB of memory")

    async def _take_messages(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        with contextlib.suppress(asyncio.IncompleteReadError):
            while True:
                message = await received(process.stdout)
                if isinstance(message, Status):
                    self.num_workers, self.capacity, self.problem = (
                        message.num_workers,
                        message.capacity,
                        message.problem,
                    )
                else:
                    self._take_answer(message)
                self._on_change()

    def _take_answer(self, answer: Answer) -> None:
        work = self.under_way.pop(answer.number)
        if answer.reply is None:
            self._on_loss(work, "a worker of the cluster was lost")
        elif not work.future.done():
            work.future.set_result(answer.reply)

    def _write(self, message: Hello | Request) -> None:
        if self._process is not None and self._process.stdin is not None and not self._process.stdin.is_closing():
            self._process.stdin.write(packed(message))

    def _resident_bytes(self) -> int:
        try:
            assert self._process is not None
            return int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]) * _PAGE_BYTES
        except (OSError, AssertionError):
            return 0
