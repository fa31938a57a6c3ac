"""The scripts of tests/benchmarks run where torch and numpy alone are installed."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
OTHERS = ("PIL", "open3d", "laspy", "pye57", "matplotlib", "typer", "rich", "ray", "httpx", "pydantic", "service")


def test_the_core_script_needs_nothing_else() -> None:
    script = ROOT / "tests" / "benchmarks" / "bench_core.py"
    program = (
        "import runpy, sys\n"
        f"sys.modules.update(dict.fromkeys({OTHERS!r}))\n"
        f"sys.argv = ['bench_core', '--quick', '--part', 'stages', '--threads', '1']\n"
        f"runpy.run_path({str(script)!r}, run_name='__main__')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    stages = json.loads(done.stdout)["stages"]["figures"]["stages"]
    assert "refine" in stages
    assert not {"decode", "draw pictures"} & set(stages)


def test_the_search_script_still_takes_its_options() -> None:
    script = ROOT / "tests" / "benchmarks" / "bench_search.py"
    done = subprocess.run([sys.executable, str(script), "--help"], capture_output=True, text=True, cwd="/")
    assert done.returncode == 0, done.stderr
    assert all(option in done.stdout for option in ("--threads", "--repeats", "--device", "--json"))
