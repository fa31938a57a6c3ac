"""What is installed is complete: every module and data file of the working tree is in the wheel."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_wheel_holds_every_module_and_data_file(tmp_path: Path) -> None:
    source = tmp_path / "source"
    skip = shutil.ignore_patterns("__pycache__", "*.egg-info", "node_modules")
    for name in ("core", "lab", "service"):
        shutil.copytree(ROOT / name, source / name, ignore=skip)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    files = [path.relative_to(source) for path in source.rglob("*") if path.is_file() and path.parent != source]
    # Of the console what is built is shipped, not its sources.
    wanted = {str(path) for path in files if not path.is_relative_to("service/console")}
    wanted |= {str(path) for path in files if path.is_relative_to("service/console/built") and path.name != ".sources"}
    assert "service/console/built/index.html" in wanted, "run scripts/build-console"
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(tmp_path), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    assert wanted - held == set()
    assert not any(name.startswith(("tests/", "build/", "service/console/src/")) for name in held)
