"""The service as its users run it: a process, spoken to over HTTP."""

import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import httpx

from panoloc.lab.process_memory import command_of, descendants

ROOT = Path(__file__).parents[2]
_WAITING = "panoloc_queue_depth "


def free_port() -> int:
    """Return a port that nobody listens on now, below those of connections and above those of Ray's workers."""
    while True:
        port = random.randrange(20_000, 32_000)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def is_running(pid: int) -> bool:
    """Tell whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def eventually(holds: Callable[[], bool], within_s: float) -> bool:
    """Poll until it holds, the more rarely the longer it takes: to ask costs the time of what is waited for."""
    began = time.monotonic()
    while not holds():
        waited_s = time.monotonic() - began
        if waited_s > within_s:
            return False
        time.sleep(min(0.02 + waited_s / 10, 0.4))
    return True


class RunningService:
    """`panoloc serve`, on a free port where the settings name none."""

    def __init__(
        self, data_dir: Path, variables: Mapping[str, str] | None = None, folder: Path = ROOT, /, **settings: str
    ) -> None:
        """variables: of the environment, beside those of the settings. folder: where the command is given."""
        self._data_dir = data_dir
        self.port = port = int(settings.get("port") or free_port())
        self._log = data_dir.with_suffix(f".{port}.log")
        own = {name: value for name, value in os.environ.items() if not name.startswith(("PANOLOC_", "RAY_"))}
        if "ray_address" in settings:  # who joins a cluster needs its token
            own |= {name: value for name, value in os.environ.items() if name.startswith("RAY_AUTH_")}
        given = {f"PANOLOC_{name.upper()}": value for name, value in settings.items()}
        environment = (
            own | dict(variables or {}) | given | {"PANOLOC_DATA_DIR": str(data_dir), "PANOLOC_PORT": str(port)}
        )
        with self._log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "panoloc.service.cli", "serve"],
                cwd=folder, env=environment, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        self.http = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=600)

    @property
    def log(self) -> str:
        """Return what the service has printed so far."""
        return self._log.read_text(errors="replace")

    def status(self, path: str) -> int | None:
        """Return the status of a GET, None when nobody answers."""
        try:
            return self.http.get(path).status_code
        except httpx.TransportError:
            return None

    def wait_until_ready(self, within_s: float = 600) -> None:
        """Return when the service takes requests; where it does not, show its log."""
        is_ready = eventually(lambda: self.status("/health/ready") == 200 or self.process.poll() is not None, within_s)
        assert is_ready, self._story()
        assert self.process.poll() is None, self._story()

    def _story(self) -> str:
        lines = [line for line in self.log.splitlines() if "path=/health" not in line]
        children = [f"{pid} {command_of(pid)}" for pid in self.family() if is_running(pid)]
        return "\n".join([f"exit code {self.process.poll()}", *children, *lines[-60:]])

    def register(self, scan: bytes, options: str, name: str = "room.ply") -> str:
        """Upload a scan, wait until the map is ready, and return its id."""
        answer = self.http.post("/maps", files={"file": (name, scan)}, data={"options": options})
        assert answer.status_code == 202, answer.text
        map_id = str(answer.json()["id"])
        assert eventually(lambda: self.map(map_id)["status"] in ("ready", "failed"), 240)
        assert self.map(map_id)["status"] == "ready", self.map(map_id)
        return map_id

    def map(self, map_id: str) -> dict[str, Any]:
        """Return the map."""
        return dict(self.http.get(f"/maps/{map_id}").json())

    def localize(self, image: bytes | list[bytes], map_id: str, options: str = '{"timeout_s": 500}') -> httpx.Response:
        """Send one query, of one image or several, and return the answer, whatever it is.

        Without options it may take long: other tests, and whoever else works on this machine, want the processors as well.
        """
        images = image if isinstance(image, list) else [image]
        files = [("image", (f"{number}.jpg", data, "image/jpeg")) for number, data in enumerate(images)]
        return self.http.post("/localize", files=files, data={"map_id": map_id, "options": options})

    def wait_until_taken(self, requests: "list[Future[httpx.Response]]") -> None:
        """Return when every request is answered, waits for a worker or runs on the only one."""

        def are_taken() -> bool:
            metrics = self.http.get("/metrics").text
            num_waiting = next(float(line.split()[1]) for line in metrics.splitlines() if line.startswith(_WAITING))
            return sum(request.done() for request in requests) + num_waiting + 1 >= len(requests)

        assert eventually(are_taken, 90)

    def family(self) -> list[int]:
        """Return the process and everything below it."""
        return [self.process.pid, *descendants(self.process.pid)]

    def worker_pid(self) -> int:
        """Return the process that answers queries."""
        (worker,) = [pid for pid in self.family() if command_of(pid) == "panoloc-worker"]
        return worker

    def stop(self) -> int:
        """Ask the service to end; return its exit code."""
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(240)
        finally:
            self.kill()

    def kill(self) -> None:
        """End the service without asking."""
        self.http.close()
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
