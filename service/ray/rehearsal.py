"""Tries in another process whether Ray starts: a start that fails holds the interpreter for half a minute, and leaves processes behind.

Called as `python -m service.ray.rehearsal FOLDER ADDRESS`; an empty address stands for a cluster of our own.
"""

import shutil
import subprocess
import sys
from pathlib import Path

from service.host.lifeline import Lifeline

_LONGEST_S = 180.0


def rehearse(address: str | None, folder: Path, lifeline: Lifeline) -> None:
    """Start or join Ray elsewhere, and end it again; blocking, and other threads go on. Raises RuntimeError where that fails."""
    command = [sys.executable, "-m", __name__, str(folder), address or ""]
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
    shutil.rmtree(folder, ignore_errors=True)
    if process.returncode:
        reason = (said.strip().splitlines() or ["it said nothing"])[-1][:300]
        raise RuntimeError(f"Ray does not start: {reason}")


def main(folder: str, address: str) -> None:
    """Start or join Ray, and end it."""
    from service.ray.cluster import RayCluster

    lifeline = Lifeline()
    cluster = RayCluster(address or None, Path(folder), lifeline)
    cluster.connect()
    cluster.disconnect()
    lifeline.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
