"""A tiny watcher that outlives the service for a moment and ends what must not outlive it.

A parent-death signal would be simpler, but it fires when the *thread* that started the child ends, and it exists on
Linux only. A pipe needs neither: the watcher reads from it, and its end is closed by the kernel however we die.
"""

import subprocess
import threading

# dash and bash alike; INT and TERM are ignored because a terminal sends them to the whole group.
_WATCH = """
trap '' INT TERM HUP
guarded=""
while read -r verb pid; do
  case $verb in
    guard) guarded="$guarded $pid" ;;
    release)
      kept=""
      for each in $guarded; do [ "$each" = "$pid" ] || kept="$kept $each"; done
      guarded=$kept ;;
  esac
done
for each in $guarded; do kill -KILL "$each"; done
"""


class Lifeline:
    """Ends guarded processes with SIGKILL when this process ends in any way without `close`."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._watcher = subprocess.Popen(
            ["/bin/sh", "-c", _WATCH],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            text=True,
        )

    def guard(self, pid: int) -> None:
        """Let `pid` end when we do. Raises OSError when the watcher is gone."""
        with self._lock:
            self._tell(f"guard {pid}")

    def release(self, pid: int) -> None:
        """Forget `pid`: call it as soon as the process is known to have ended, before its id can be given again."""
        with self._lock:
            self._tell(f"release {pid}")

    def close(self) -> None:
        """End the watcher; what is still guarded ends with it."""
        with self._lock:
            if self._watcher.stdin is not None:
                self._watcher.stdin.close()
        self._watcher.wait(timeout=10)

    def _tell(self, line: str) -> None:
        if self._watcher.stdin is None:
            raise BrokenPipeError("lifeline: the watcher has no pipe")
        self._watcher.stdin.write(line + "\n")
        self._watcher.stdin.flush()
