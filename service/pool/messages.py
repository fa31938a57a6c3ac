"""The messages between the service and its worker processes: pickled values, each after its length, through private pipes."""

import asyncio
import os
import pickle
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO, Literal

from panoloc.service.worker.plan import WorkerPlan
from panoloc.service.worker.reply import WorkerReply

_LENGTH = struct.Struct("<Q")

Kind = Literal["localize", "register", "rebuild", "cancel"]


@dataclass(frozen=True)
class Hello:
    """The first message to a process: what it shall run. log: level and format."""

    plan: WorkerPlan
    log: tuple[str, Literal["console", "json"]] = ("info", "console")


@dataclass(frozen=True)
class Request:
    """Work for a process. job: a LocalizeJob, a RegisterJob or a MapRef, by `kind`; None to cancel the request with this number."""

    number: int
    kind: Kind
    job: Any


@dataclass(frozen=True)
class Status:
    """What a process can do now. num_workers: workers that are up; capacity: requests that it takes at a time; problem: why fewer."""

    num_workers: int
    capacity: int
    problem: str = ""


@dataclass(frozen=True)
class Answer:
    """The reply to a request; None when the worker behind the process was lost."""

    number: int
    reply: WorkerReply[Any] | None


def packed(message: object) -> bytes:
    """Return a message as bytes for the pipe."""
    data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    return _LENGTH.pack(len(data)) + data


async def received(stream: asyncio.StreamReader) -> Any:
    """Return the next message. Raises asyncio.IncompleteReadError at the end of the stream."""
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
        self._answers.write(packed(message))
        self._answers.flush()

    def receive(self) -> Any:
        """Return the next message. Raises EOFError when the service has ended."""
        header = self._requests.read(_LENGTH.size)
        if len(header) < _LENGTH.size:
            raise EOFError
        return pickle.loads(self._requests.read(*_LENGTH.unpack(header)))

    def follow(self, take: Callable[[Request], None]) -> None:
        """Pass every request to `take`, and end this process when the service has ended, however that happened."""
        while True:
            try:
                take(self.receive())
            except (EOFError, pickle.UnpicklingError):
                os._exit(0)
