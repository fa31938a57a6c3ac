"""The fork server, `python -m panoloc.service.pool.fork_server MODULE...`: loads the modules once and forks workers and builders.

A forked process starts in milliseconds, where one of its own loads torch for a second or two, and shares that memory.
Linux only. The server itself computes nothing: threads and a CUDA context would not survive the fork.
"""

import contextlib
import ctypes
import gc
import importlib
import os
import pickle
import selectors
import signal
import socket
import sys
from typing import Any

from panoloc.service.pool import child
from panoloc.service.pool.forked_process import LONGEST_REQUEST, NUMBER

_SET_DEATH_SIGNAL, _SET_NAME = 1, 15


class _ForkServer:
    """Takes requests until the service ends, and watches what it has forked. A process is killed when its control socket is closed."""

    def __init__(self, requests: socket.socket) -> None:
        self._requests = requests
        self._events = selectors.DefaultSelector()
        self._events.register(requests, selectors.EVENT_READ)
        self._controls: dict[int, socket.socket] = {}
        self._ends: dict[int, int] = {}

    def next_child(self) -> str:
        """Serve; return in each forked process, there with what it shall run."""
        while True:
            for key, _ in self._events.select():
                if key.fileobj is self._requests:
                    if (what := self._fork()) is not None:
                        return what
                elif key.data not in self._controls:
                    continue  # its other event came first
                elif key.fileobj == self._ends[key.data]:
                    self._tell_end(key.data)
                elif _is_closed(self._controls[key.data]):
                    self._events.unregister(key.fileobj)
                    os.kill(key.data, signal.SIGKILL)  # it is not reaped yet, so the id is still its own

    def _fork(self) -> str | None:
        request, pipes, _, _ = socket.recv_fds(self._requests, LONGEST_REQUEST, 2)
        if not request:
            sys.exit()  # the service has ended, and all that was forked ends with this process
        what, variables = pickle.loads(request)
        conversation, control = pipes
        try:
            pid = os.fork()
        except OSError:  # no memory, or too many processes: whoever asked sees that both are closed
            os.close(conversation)
            os.close(control)
            return None
        if pid == 0:
            self._become_child(what, variables, conversation, control)
            return str(what)
        os.close(conversation)
        self._controls[pid], self._ends[pid] = socket.socket(fileno=control), os.pidfd_open(pid)
        self._events.register(self._controls[pid], selectors.EVENT_READ, pid)
        self._events.register(self._ends[pid], selectors.EVENT_READ, pid)
        self._tell(pid, pid)
        return None

    def _become_child(self, what: str, variables: dict[str, str], conversation: int, control: int) -> None:
        _prctl(_SET_DEATH_SIGNAL, signal.SIGKILL)
        _prctl(_SET_NAME, f"panoloc-{what}".encode())
        os.setsid()
        self._events.close()
        for each in (self._requests, *self._controls.values()):
            each.close()
        for number in (control, *self._ends.values()):
            os.close(number)
        os.environ.update(variables)
        os.dup2(conversation, 0)
        os.dup2(conversation, 1)
        os.close(conversation)

    def _tell_end(self, pid: int) -> None:
        self._tell(pid, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
        control, end = self._controls.pop(pid), self._ends.pop(pid)
        for each in (control, end):
            with contextlib.suppress(KeyError):  # one that was closed is not watched any more
                self._events.unregister(each)
        control.close()
        os.close(end)

    def _tell(self, pid: int, number: int) -> None:
        with contextlib.suppress(OSError):  # nobody may wait for it any more
            self._controls[pid].send(NUMBER.pack(number))


def _is_closed(control: socket.socket) -> bool:
    try:
        return not control.recv(1)
    except OSError:  # closed before everything was read
        return True


def _prctl(option: int, value: Any) -> None:
    ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def main(*modules: str) -> None:
    """Load the modules, then fork a process for each request that comes through standard input."""
    requests = socket.socket(fileno=os.dup(0))
    gc.disable()  # nothing of what is loaded is garbage; to look for it takes a sixth of the time
    for module in modules:
        with contextlib.suppress(Exception):  # the process that needs it says why
            importlib.import_module(module)
    gc.freeze()  # what is there now stays, and memory that nobody writes to stays common
    gc.enable()
    child.main(_ForkServer(requests).next_child())


if __name__ == "__main__":
    main(*sys.argv[1:])
