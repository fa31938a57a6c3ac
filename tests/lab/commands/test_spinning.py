"""Commands that compute in their own process leave the processors to others where their threads wait."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_UNTIL_TORCH_IS_WANTED = """
import os, sys
from panoloc.service.cli.entry import run

class Watch:
    def find_spec(self, name, *_):
        if name == "torch":
            print(os.environ["GOMP_SPINCOUNT"])
            raise SystemExit(0)

assert "torch" not in sys.modules
sys.meta_path.insert(0, Watch())
run(sys.argv[1:])
"""


@pytest.mark.parametrize("command", ["evaluate", "bench"])
def test_how_long_threads_spin_is_said_before_torch_reads_it(command: str, tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "GOMP_SPINCOUNT"}
    done = subprocess.run(
        [sys.executable, "-c", _UNTIL_TORCH_IS_WANTED, command, "--out", str(tmp_path)],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout == "5000\n", done.stderr
