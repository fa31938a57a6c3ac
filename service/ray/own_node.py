"""Starts a Ray of the service's own in a process of its own: a start that fails would hold the service's interpreter for half a minute.

Called as `python -m service.ray.own_node FOLDER NUM_CPUS`. It prints the address and becomes a shell that ends Ray when its input does.
"""

import contextlib
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

_log = logging.getLogger(__name__)

_LONGEST_S = 240.0
# Ray gives its raylet 30 s; on a machine with twenty times its work it needs two minutes.
_RAYLET_S = 150.0
_PAUSE_S = 0.1  # between two looks for it
_END_S = 10.0
_SAID = "Ray listens at "
# Panoramas and pictures in flight; what does not fit goes to disk.
_OBJECT_STORE_BYTES = 128 * 2**20
# The input ends when the service does, in whatever way. The group is what this process has started.
_END_WITH_INPUT = "read -r _; kill -KILL 0"


class RayStartError(RuntimeError):
    """Ray does not start, or cannot be joined; the message has what it said."""


class OwnNode:
    """GCS and raylet, below a process that ends with us. Blocking; may be used in any thread."""

    def __init__(self, folder: Path) -> None:
        """Begin to start it; folder: short path for Ray's sockets and logs."""
        # Logical: a worker, a registration and a rebuild have to find a place on a machine with one core, too.
        command = [sys.executable, "-m", __name__, str(folder), str(max(4, os.cpu_count() or 1))]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
        )

    def address(self) -> str:
        """Wait until it runs and return the address to join. Raises RayStartError with what Ray said where it does not."""
        said = self._said()
        address = next((line.removeprefix(_SAID) for line in said if line.startswith(_SAID)), None)
        if address is None:
            reason = ([line for line in said if line.strip()] or ["it said nothing"])[-1][:300]
            raise RayStartError(f"Ray does not start: {reason}")
        return address

    def end(self) -> None:
        """End what is left of it."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def _said(self) -> list[str]:
        """Return the lines up to the one with the address, or all of them where there is none in time."""
        assert self._process.stdout is not None
        deadline, said = time.monotonic() + _LONGEST_S, ""
        while select.select([self._process.stdout], [], [], max(0.0, deadline - time.monotonic()))[0]:
            data = os.read(self._process.stdout.fileno(), 65536)
            said += data.decode(errors="replace")
            lines = said.splitlines(keepends=True)
            if not data or any(line.startswith(_SAID) and line.endswith("\n") for line in lines):
                return [line.rstrip() for line in lines]
        return [f"it took longer than {_LONGEST_S:.0f} s"]


def main(folder: str, num_cpus: str) -> None:
    """Start GCS and raylet, then wait for the end of the input as a process of one megabyte."""
    threading.Thread(target=_end_all_with_input, daemon=True).start()
    try:
        address = _start(folder, int(num_cpus))
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        os.killpg(0, signal.SIGKILL)
        raise
    print(f"{_SAID}{address}", flush=True)
    os.execv("/bin/sh", ["sh", "-c", _END_WITH_INPUT])


def _end_all_with_input() -> None:
    os.read(0, 1)
    os.killpg(0, signal.SIGKILL)


def _start(folder: str, num_cpus: int) -> str:
    from ray._private.node import Node
    from ray._private.parameter import RayParams

    _start_only_what_is_needed()
    _wait_longer_for_the_raylet()
    stay_on_loopback()
    parameters = RayParams(
        node_ip_address="127.0.0.1",
        num_cpus=num_cpus,
        include_dashboard=False,
        object_store_memory=_OBJECT_STORE_BYTES,
        temp_dir=folder,
    )
    # Neither hooks nor a reaper: what it starts outlives this Python, and ends with the shell after it.
    node = Node(parameters, head=True, shutdown_at_exit=False, spawn_reaper=False, ray_init_cluster=True)
    return str(node.gcs_address)


def stay_on_loopback() -> None:
    """Let Ray listen where it is told to: it takes 127.0.0.1 for this machine's address in the network, and opens its ports to that."""
    from ray._private import services

    if hasattr(services, "resolve_ip_for_localhost"):
        services.resolve_ip_for_localhost = lambda host: host
    else:
        _log.warning("Ray has changed: its ports may be open to the network; close them with a firewall")


def _start_only_what_is_needed() -> None:
    """Leave out autoscaler monitor, API server and log monitor, which serve a dashboard that we do not have.

    Ray has no switch for them, and waits up to a minute for the API server: 177 MB, and half of the processor time of a start.
    """
    from ray._private.node import Node

    for name in ("start_monitor", "start_api_server", "start_log_monitor"):
        if hasattr(Node, name):
            setattr(Node, name, _start_nothing)
        else:
            _log.warning("Ray has changed: a process of it that nobody needs may run", extra={"call": name})


def _wait_longer_for_the_raylet() -> None:
    """Let the raylet take its time on a busy machine: Ray has no setting for the 30 s that it gives it, and begins anew afterwards, which
    takes no less time."""
    from ray._private import services

    if hasattr(services, "get_node"):
        services.get_node = patient(services.get_node, _RAYLET_S)
    else:
        _log.warning("Ray has changed: on a busy machine it may give up its start after 30 s and begin anew")


def patient(ask: Callable[..., Any], within_s: float) -> Callable[..., Any]:
    """Return `ask`, asked again for `within_s` while it raises RuntimeError, which is how Ray says that a node is not there yet."""

    def asked(*arguments: Any, **named: Any) -> Any:
        deadline = time.monotonic() + within_s
        while True:
            try:
                return ask(*arguments, **named)
            except RuntimeError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(_PAUSE_S)

    return asked


def _start_nothing(node: Any, **_: Any) -> None:
    """Stand in for a method of Ray's `Node`."""


if __name__ == "__main__":
    main(*sys.argv[1:])
