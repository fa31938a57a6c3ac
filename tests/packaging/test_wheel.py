"""What is built is complete: every module and data file is in the wheel, the console too, or there is no wheel."""

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUILT = "service/console/built"
ROS2 = "clients/ros2/panoloc_ros2/"
# The compiler with an empty file in place of each source, once all that the source includes was found.
_COMPILES_NOTHING = """#!/bin/sh
case "$*" in *.cpp*) c++ "$@" -E || exit ;; esac
for each; do
  shift
  case $each in *.cpp) set -- "$@" -x c++ /dev/null ;; *) set -- "$@" "$each" ;; esac
done
exec c++ "$@"
"""


def build(source: Path, target: Path) -> subprocess.CompletedProcess[str]:
    """Build an sdist and a wheel of `source` without asking a registry."""
    program = (
        "import sys, setuptools.build_meta as backend\n"
        "target = sys.argv[1]\n"
        "backend.build_sdist(target), backend.build_wheel(target)\n"
    )
    # What kernels are built into is looked at here. That their sources compile is known where this runs: so they were installed.
    compiler = target / "compiler"
    compiler.write_text(_COMPILES_NOTHING)
    compiler.chmod(0o755)
    command = [sys.executable, "-c", program, str(target)]
    environment = {**os.environ, "CXX": str(compiler)}
    return subprocess.run(command, cwd=source, capture_output=True, text=True, timeout=280, env=environment)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Return a copy of what a wheel is made of, as a clone has it: without the built console."""
    copy = tmp_path / "source"
    skip = shutil.ignore_patterns("__pycache__", "*.egg-info", "node_modules", "built", "*.so")
    for name in ("clients", "core", "lab", "panoloc", "service"):
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=skip)
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    return copy


@pytest.mark.slow
def test_wheel_and_sdist_hold_every_module_and_data_file(source: Path, tmp_path: Path) -> None:
    shutil.copytree(ROOT / BUILT, source / BUILT)
    assert (source / BUILT / "index.html").exists(), "run scripts/build-console"
    files = [path.relative_to(source) for path in source.rglob("*") if path.is_file() and path.parent != source]
    # Of the console what is built is shipped, not its sources.
    wanted = {str(path) for path in files if not path.is_relative_to("service/console")}
    wanted |= {str(path) for path in files if path.is_relative_to(BUILT) and path.name != ".sources"}
    # Of the clients the modules that are a package here; colcon builds the rest.
    wanted = {
        name.replace(ROS2, "ros2/") for name in wanted if name.startswith(ROS2) or not name.startswith("clients/")
    }
    done = build(source, tmp_path)
    assert done.returncode == 0, done.stderr
    (wheel,), (sdist,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    in_wheel = set(zipfile.ZipFile(wheel).namelist())
    with tarfile.open(sdist) as archive:
        in_sdist = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    for held in (in_wheel, in_sdist):
        assert {name for name in wanted if not {name, f"panoloc/{name}"} & held} == set()
        assert not any("console/src/" in name or name.startswith(("tests/", "build/")) for name in held)

    kernels = {name.split(".")[0] for name in in_wheel if name.endswith(".so")}
    assert kernels == {f"panoloc/core/kernels/_{build}" for build in ("baseline", "x86_64_v3", "x86_64_v4")}


@pytest.mark.slow
def test_without_the_console_nothing_is_built_and_the_reason_is_said(source: Path, tmp_path: Path) -> None:
    done = build(source, tmp_path)
    assert done.returncode != 0
    assert "expected the built console" in done.stderr
    assert "run scripts/build-console" in done.stderr
    assert not [*tmp_path.glob("*.whl"), *tmp_path.glob("*.tar.gz")]
