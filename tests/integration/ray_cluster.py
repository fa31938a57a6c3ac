"""A Ray cluster of somebody else's: a head and further nodes, each of which can be killed with all that it has started."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Self

from panoloc.lab.process_memory import descendants
from tests.integration.running_service import ROOT, eventually, free_port

_RUNS = b"will now block forever"
_OBJECT_STORE_BYTES = 80_000_000


class RayClusterOfOthers:
    """One head and so many more nodes on this machine; a context manager that ends them. Nodes have numbers, the head is 0."""

    def __init__(self, num_nodes: int = 0, num_cpus: int = 4) -> None:
        """num_cpus: of each node, in Ray's own counting."""
        self._folder = tempfile.TemporaryDirectory(prefix="pl-", ignore_cleanup_errors=True)
        self._num_cpus = num_cpus
        self._processes: dict[int, subprocess.Popen[bytes]] = {}
        self.address = f"127.0.0.1:{free_port()}"
        try:
            for number in range(num_nodes + 1):
                self.start(number)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def start(self, number: int) -> None:
        """Start a node. Ray gives its raylet 30 s, which on a busy machine is too little, so it is tried again."""
        place = (
            ["--head", "--include-dashboard=false", "--no-monitor",
             f"--port={self.address.rpartition(':')[2]}", f"--temp-dir={self._folder.name}"]
            if number == 0
            else [f"--address={self.address}"]
        )  # fmt: skip
        command = [
            str(Path(sys.executable).with_name("ray")), "start", "--block", f"--num-cpus={self._num_cpus}",
            f"--object-store-memory={_OBJECT_STORE_BYTES}", "--node-ip-address=127.0.0.1",
            "--include-log-monitor=false", *place,
        ]  # fmt: skip
        log = Path(self._folder.name) / f"node-{number}.log"
        # What a node starts has to find this code, and tests.
        environment = os.environ | {"RAY_USAGE_STATS_ENABLED": "0", "PYTHONPATH": str(ROOT)}
        for _ in range(5):
            with log.open("wb") as out:
                process = subprocess.Popen(command, stdout=out, stderr=out, env=environment, start_new_session=True)
            self._processes[number] = process
            eventually(lambda tried=process: tried.poll() is not None or _RUNS in log.read_bytes(), 240)  # type: ignore[misc]
            if process.poll() is None and _RUNS in log.read_bytes():
                return
            self.kill(number)
        raise AssertionError(log.read_text(errors="replace")[-3000:])

    def family(self, number: int) -> list[int]:
        """Return the processes of a node: Ray's own and the workers on it."""
        return [self._processes[number].pid, *descendants(self._processes[number].pid)]

    def kill(self, number: int) -> None:
        """Kill a node with all that it has started, at once."""
        process = self._processes.pop(number)
        for pid in [process.pid, *descendants(process.pid)]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.wait()

    def close(self) -> None:
        """Kill every node, the head last."""
        for number in sorted(self._processes, reverse=True):
            self.kill(number)
        self._folder.cleanup()


def start_workers(address: str, data: Path, redis_url: str) -> None:
    """Run `panoloc workers` on a cluster, as an operator would."""
    variables = {"PANOLOC_DATA_DIR": str(data), "PANOLOC_REDIS_URL": redis_url, "PANOLOC_RAY_ADDRESS": address}
    command = [sys.executable, "-m", "panoloc.service.cli", "workers"]
    ended = subprocess.run(command, cwd=ROOT, env=os.environ | variables, capture_output=True, text=True, timeout=240)
    assert ended.returncode == 0, ended.stdout + ended.stderr
