"""Ray's logs of ended workers go, those of living ones and of Ray itself stay."""

import os
import subprocess
import sys
import time
from pathlib import Path

from service.ray.ended_logs import remove_logs_of_ended


def ended_process() -> int:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        return process.pid


def test_logs_of_ended_workers_are_removed_after_a_while_and_no_others(tmp_path: Path) -> None:
    gone, alive = ended_process(), os.getpid()
    ended = [f"worker-ab12-01000000-{gone}.{end}" for end in ("out", "err")] + [f"python-core-worker-ab12_{gone}.log"]
    others = [
        f"worker-ab12-01000000-{alive}.out",
        f"python-core-driver-01000000_{gone}.log",
        "raylet.out",
        "gcs_server.out",
    ]
    for name in (*ended, *others):
        (tmp_path / name).write_text("log")
    assert remove_logs_of_ended(tmp_path, kept_s=60) == 0
    for name in (*ended, *others):
        os.utime(tmp_path / name, (time.time() - 100,) * 2)
    assert remove_logs_of_ended(tmp_path, kept_s=60) == 3
    assert {file.name for file in tmp_path.iterdir()} == set(others)


def test_before_ray_has_started_there_is_nothing_to_remove(tmp_path: Path) -> None:
    assert remove_logs_of_ended(tmp_path / "none") == 0
