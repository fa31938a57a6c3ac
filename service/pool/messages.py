"""The messages between the service and its worker processes: pickled values through private pipes.

The first message to a process is the `WorkerPlan` that it shall run; then come requests. Its own messages follow their length.
"""

import asyncio
import os
import pickle
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO

from panoloc.service.jobs import LocalizeJob, MapRef, RegisterJob
from panoloc.service.worker.plan import WorkerReply

_LENGTH = struct.Struct("<Q")

Build = RegisterJob | MapRef
"""A registration, or the map whose index has to be built again."""


@dataclass(frozen=True)
class Request:
    """Work for a process. job: None to cancel the request with this number."""

    number: int
    job: LocalizeJob | Build | None


@dataclass(frozen=True)
class Status:
    """What a process can do now. num_workers: workers that are up; capacity: requests that it takes at a time; problem: why fewer."""

    num_workers: int = 0
    capacity: int = 0
    problem: str = ""


@dataclass(frozen=True)
class Answer:
    """The reply to a request; None when the worker behind the process was lost."""

    number: int
    reply: WorkerReply[Any] | None


async def received(stream: asyncio.StreamReader) -> Any:
    """Return the next message of a process. Raises asyncio.IncompleteReadError at the end of the stream."""
    (length,) = _LENGTH.unpack(await stream.readexactly(_LENGTH.size))
    return pickle.loads(await stream.readexactly(length))


class ChildPipes:
    """The pipes in the child process. What libraries print goes to standard error, not between the messages."""

    def __init__(self) -> None:
        self._requests: BinaryIO = os.fdopen(os.dup(0), "rb")
        self._answers: BinaryIO = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)

    def send(self, message: Status | Answer) -> None:
        """Send one message."""
        data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        self._answers.write(_LENGTH.pack(len(data)) + data)
        self._answers.flush()

    def receive(self) -> Any:
        """Return the next message. Raises EOFError or pickle.UnpicklingError when the service has ended."""
        return pickle.load(self._requests)

    def follow(self, take: Callable[[Request], None]) -> None:
        """Pass every request to `take`, and end this process when the service has ended, however that happened."""
        while True:
            try:
                take(self.receive())
            except (EOFError, pickle.UnpicklingError):
                os._exit(0)
