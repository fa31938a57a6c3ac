"""In which order the processes of a Ray of the service's own end. Their stand-ins need no Ray."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from service.host.lifeline import Lifeline
from service.ray import cluster
from service.ray.cluster import RayCluster

# Ends when asked to, after a moment, and says how its GCS was then: a zombie is gone, too.
RAYLET = """
import signal, sys, time
from pathlib import Path

def end(*_):
    time.sleep(0.1)
    state = Path(f"/proc/{sys.argv[1]}/stat").read_text().rpartition(")")[2].split()[0]
    Path(sys.argv[2]).write_text(state)
    sys.exit()

signal.signal(signal.SIGTERM, end)
print("ready", flush=True)
while True:
    time.sleep(1)
"""


@pytest.fixture
def gcs() -> Iterator["subprocess.Popen[bytes]"]:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as process:
        yield process
        process.kill()


def test_the_raylet_ends_while_its_gcs_still_runs(
    gcs: "subprocess.Popen[bytes]", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "_import_ray", lambda: SimpleNamespace(shutdown=lambda: None))
    monkeypatch.setattr(cluster, "_forget_controller", lambda: None)
    said, lifeline = tmp_path / "state", Lifeline()
    command = [sys.executable, "-c", RAYLET, str(gcs.pid), str(said)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as raylet:
        assert raylet.stdout is not None
        assert raylet.stdout.readline() == b"ready\n"
        ours = RayCluster(None, tmp_path, lifeline)
        ours._guarded = {gcs.pid: "gcs_server", raylet.pid: "raylet"}
        for pid in ours._guarded:
            lifeline.guard(pid)
        ours.disconnect()
        assert raylet.wait(60) == 0
    lifeline.close()
    assert said.read_text() not in "ZX"
    assert gcs.wait(60) == -9
