"""Removes the log files of Ray's processes that have ended: five of each registration, which Ray keeps for ever."""

import contextlib
import os
import re
import time
from pathlib import Path

# worker-….out, worker-….err and python-core-worker-….log, each with the process id last.
_OF_WORKER = re.compile(r"(?:worker-|python-core-worker-).*[-_](\d+)\.(?:out|err|log)")
_KEPT_S = 600.0


def remove_logs_of_ended(logs: Path, kept_s: float = _KEPT_S) -> int:
    """Remove files that ended workers have written last more than `kept_s` ago; return how many. Blocking."""
    num_removed = 0
    with contextlib.suppress(FileNotFoundError):
        for file in logs.iterdir():
            found = _OF_WORKER.fullmatch(file.name)
            if found is None or _is_alive(int(found[1])):
                continue
            with contextlib.suppress(OSError):
                if time.time() - file.stat().st_mtime > kept_s:
                    file.unlink()
                    num_removed += 1
    return num_removed


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
