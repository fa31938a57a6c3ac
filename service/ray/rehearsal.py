"""Tries in another process whether a Ray cluster can be joined: joining one that is away holds the interpreter for half a minute.

Called as `python -m service.ray.rehearsal ADDRESS`.
"""

import socket
import subprocess
import sys
from pathlib import Path

from service.host.lifeline import Lifeline
from service.ray.own_node import RayStartError

_LONGEST_S = 180.0
_ANSWER_S = 10.0


def rehearse(address: str, lifeline: Lifeline) -> None:
    """Join a cluster elsewhere, and leave it again; blocking, and other threads go on. Raises RayStartError where that fails."""
    command = [sys.executable, "-m", __name__, address]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        lifeline.guard(process.pid)
        try:
            said = process.communicate(timeout=_LONGEST_S)[1].decode(errors="replace")
        except subprocess.TimeoutExpired:
            process.kill()
            said = f"it took longer than {_LONGEST_S:.0f} s"
        finally:
            process.wait()
            lifeline.release(process.pid)
    if process.returncode:
        reason = (said.strip().splitlines() or ["it said nothing"])[-1][:300]
        raise RayStartError(f"Ray cannot be joined: {reason}")


def main(address: str) -> None:
    """Join Ray, and leave it."""
    from service.ray.cluster import RayCluster

    host, _, port = address.rpartition(":")
    if port.isdecimal():
        # Where nobody listens, Ray would try for minutes.
        socket.create_connection((host.strip("[]"), int(port)), _ANSWER_S).close()
    lifeline = Lifeline()
    cluster = RayCluster(address, Path(), lifeline)
    cluster.connect()
    cluster.disconnect()
    lifeline.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
