"""One child process of the service and the requests that it works on. Used from one event loop."""

import asyncio
import contextlib
import os
import pickle
import signal
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from panoloc.service.errors import NoWorkerError
from panoloc.service.jobs import LocalizeJob, MapRef
from panoloc.service.pool.forked_process import ForkedProcess, ForkServer
from panoloc.service.pool.messages import Build, Request, Status, received
from panoloc.service.worker.plan import WorkerPlan, WorkerReply

_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
# A search checks its deadline often. One that is this late hangs in native code.
OVERDUE_S = 60.0

Process = ForkedProcess | asyncio.subprocess.Process


class WorkerLostError(Exception):
    """The process that worked on a request ended, or the worker behind it; the message says how."""


@dataclass(order=True)
class Work:
    """A request on its way through the pool. number: its place in the queue. future: its reply, or WorkerLostError."""

    number: int
    job: LocalizeJob | Build = field(compare=False)
    future: "asyncio.Future[WorkerReply[Any]]" = field(
        default_factory=lambda: asyncio.get_running_loop().create_future(), compare=False
    )

    @property
    def maps(self) -> frozenset[MapRef]:
        """Return the maps whose indexes a worker needs for it."""
        return frozenset(self.job.maps) if isinstance(self.job, LocalizeJob) else frozenset()

    def fail(self, error: Exception) -> None:
        """Let the waiting call raise, if it still waits."""
        if not self.future.done():
            self.future.set_exception(error)


@dataclass(eq=False)
class WorkerProcess:
    """A process that speaks as `panoloc.service.pool.messages` says. It ends when the service ends: the kernel then closes its input.

    start: starts the process, with pipes. on_change: called after each message. status: what it said last, without workers once it has
    ended. was_ready: whether it was ready when it ended. under_way: what it works on, by number. known_maps: maps that it has answered for.
    """

    plan: WorkerPlan
    start: Callable[[], Awaitable[Process]]
    on_change: Callable[[], None] = lambda: None
    status: Status = field(default_factory=Status, init=False)
    was_ready: bool = field(default=False, init=False)
    under_way: dict[int, Work] = field(default_factory=dict, init=False)
    known_maps: set[MapRef] = field(default_factory=set, init=False)
    _process: Process | None = field(default=None, init=False)
    _killed_for: str = field(default="", init=False)

    async def run(self) -> str:
        """Start the process, take its messages until it ends, and return how it ended. Cancelling the call kills it."""
        process = self._process = await self.start()
        try:
            self._write(self.plan)
            for work in self.under_way.values():
                self._write(Request(work.number, work.job))
            await self._take_messages(process)
        finally:
            self.was_ready = self.status.capacity > 0
            self.status = Status(problem=self.status.problem)
            self.kill()
            code = await process.wait()
            how = self._killed_for or (signal.Signals(-code).name if code < 0 else f"exit code {code}")
            while self.under_way:
                self.under_way.popitem()[1].fail(WorkerLostError(how))
        return how

    def begin(self, work: Work) -> None:
        """Send a request; its reply comes into its future."""
        self.under_way[work.number] = work
        self.known_maps |= work.maps
        self._write(Request(work.number, work.job))

    def cancel(self, work: Work) -> None:
        """Let the process drop a request that nobody waits for."""
        self._write(Request(work.number, None))

    def kill(self, reason: str = "") -> None:
        """End the process, whatever it is doing. reason: what `run` returns then."""
        self._killed_for = self._killed_for or reason
        if self._process is not None and self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()

    def end_if_astray(self, memory_bytes: int) -> None:
        """Kill the process when it hangs or has more memory than it may. memory_bytes: resident memory that it may have."""
        due = [work.job.deadline_unix_s for work in self.under_way.values() if isinstance(work.job, LocalizeJob)]
        if due and time.time() > min(due) + OVERDUE_S:
            self.kill(f"a query was {OVERDUE_S:.0f} s past its deadline")
        elif self._resident_bytes() > memory_bytes:
            self.kill(f"it used more than {memory_bytes / 2**30:.1f} GiB of memory")

    async def _take_messages(self, process: Process) -> None:
        assert process.stdout is not None
        with contextlib.suppress(asyncio.IncompleteReadError):
            while True:
                message = await received(process.stdout)
                if isinstance(message, Status):
                    self.status = message
                else:
                    work = self.under_way.pop(message.number)
                    if message.reply is None:
                        work.fail(WorkerLostError("a worker of the cluster was lost"))
                    elif not work.future.done():
                        work.future.set_result(message.reply)
                self.on_change()

    def _write(self, message: WorkerPlan | Request) -> None:
        """Send a message to the process, if it is there; what is under way is sent when it starts."""
        if self._process is not None and self._process.stdin is not None and not self._process.stdin.is_closing():
            self._process.stdin.write(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))

    def _resident_bytes(self) -> int:
        try:
            assert self._process is not None
            return int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]) * _PAGE_BYTES
        except (OSError, AssertionError):
            return 0


async def run_build(plan: WorkerPlan, job: Build, server: ForkServer) -> WorkerReply[Any]:
    """Run one registration or rebuild in a process of its own, so that queries come first and its memory is returned at the end.

    server: starts it. Cancelling the call ends the process. Raises NoWorkerError when the process dies.
    """
    work = Work(0, job)
    process = WorkerProcess(plan, lambda: server.start("builder"))
    process.begin(work)
    running = asyncio.create_task(process.run())
    running.add_done_callback(lambda _: work.fail(WorkerLostError("it could not be started")))
    try:
        return await work.future
    except WorkerLostError as lost:
        raise NoWorkerError(
            f"the process that builds the map ended ({lost}); the memory may be too small for this scan"
        ) from lost
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
