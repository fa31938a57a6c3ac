"""Processes of the service: programs with a fresh interpreter, and those that a fork server starts in milliseconds.

Both end when the service ends, however that happens.
"""

import asyncio
import contextlib
import os
import pickle
import signal
import socket
import struct
import sys
from collections.abc import Iterable, Mapping
from typing import Any

from panoloc.service.host.process_resources import SPINNING

NUMBER = struct.Struct("<q")
"""What a fork server writes to the control socket of a process: its id, and at its end the exit code, or minus the signal."""

LONGEST_REQUEST = 1 << 16
_BUFFER_BYTES = 1 << 20
# glibc keeps freed panoramas in up to eight heaps per core otherwise.
_ENVIRONMENT = {"MALLOC_ARENA_MAX": "2", **SPINNING}


async def start_program(
    module: str, *arguments: str, variables: Mapping[str, str] | None = None, **pipes: Any
) -> asyncio.subprocess.Process:
    """Start `python -m MODULE ARGUMENT...` with pipes, or as `pipes` says. variables: for its environment. Raises OSError."""
    environment = _ENVIRONMENT | dict(os.environ) | dict(variables or {})
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    # A session of its own: a terminal's interrupt is for the service, which lets the work under way end.
    return await asyncio.create_subprocess_exec(
        sys.executable, "-P", "-m", module, *arguments, env=environment, start_new_session=True, limit=_BUFFER_BYTES,
        **{"stdin": asyncio.subprocess.PIPE, "stdout": asyncio.subprocess.PIPE, **pipes},
    )  # fmt: skip


class ForkedProcess:
    """A process that a fork server has started; used like one of asyncio. Its pipes are a socket."""

    def __init__(
        self, pid: int, control: socket.socket, stdout: asyncio.StreamReader, stdin: asyncio.StreamWriter
    ) -> None:
        self.pid = pid
        self.stdout = stdout
        self.stdin = stdin
        self.returncode: int | None = None
        self._control = control

    def kill(self) -> None:
        """End the process, whatever it is doing."""
        with contextlib.suppress(OSError):  # it has ended
            self._control.shutdown(socket.SHUT_WR)

    async def wait(self) -> int:
        """Return the exit code, or minus the signal that ended the process."""
        end = await _next_number(self._control)
        # A fork server that is killed takes with it what it has forked.
        self.returncode = -signal.SIGKILL if end is None else end
        self.stdin.close()
        self._control.close()
        return self.returncode


class ForkServer:
    """Starts processes that have `modules` loaded; see `panoloc.service.pool.fork_server`. Used from one event loop."""

    def __init__(self, modules: Iterable[str]) -> None:
        self._modules = sorted(modules)
        self._starting = asyncio.Lock()
        self._server: asyncio.subprocess.Process | None = None
        self._requests: socket.socket | None = None

    async def start(
        self, what: str, variables: Mapping[str, str] | None = None
    ) -> "ForkedProcess | asyncio.subprocess.Process":
        """Start a "worker" or "builder". variables: for its environment. Raises OSError."""
        if sys.platform != "linux":  # elsewhere not every library survives a fork
            return await start_program("panoloc.service.pool.child", what, variables=variables)
        async with self._starting:
            if self._server is None or self._server.returncode is not None:
                await self._start_server()
        (ours, its), (control, its_control) = socket.socketpair(), socket.socketpair(type=socket.SOCK_SEQPACKET)
        try:
            with its, its_control:
                assert self._requests is not None
                request = pickle.dumps((what, dict(variables or {})))
                socket.send_fds(self._requests, [request], [its.fileno(), its_control.fileno()])
            control.setblocking(False)
            if (pid := await _next_number(control)) is None:
                raise OSError("the fork server has ended, or cannot fork")
            return ForkedProcess(pid, control, *await asyncio.open_unix_connection(sock=ours, limit=_BUFFER_BYTES))
        except BaseException:
            ours.close()
            control.close()  # the server then kills what it has started
            raise

    async def stop(self) -> None:
        """End the server, and with it what it has forked."""
        if self._server is not None and self._requests is not None:
            self._requests.close()
            await self._server.wait()

    async def _start_server(self) -> None:
        with contextlib.ExitStack() as given_up:
            requests, its_requests = (
                given_up.enter_context(each) for each in socket.socketpair(type=socket.SOCK_SEQPACKET)
            )
            self._server = await start_program(
                "panoloc.service.pool.fork_server", *self._modules, stdin=its_requests.fileno(), stdout=None
            )
            if self._requests is not None:
                self._requests.close()  # of one that has ended
            self._requests = socket.socket(fileno=requests.detach())


async def _next_number(control: socket.socket) -> int | None:
    """Return what the server writes next; None when it has ended."""
    with contextlib.suppress(OSError):
        if message := await asyncio.get_running_loop().sock_recv(control, NUMBER.size):
            return int(NUMBER.unpack(message)[0])
    return None
