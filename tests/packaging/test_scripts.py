"""The shell scripts are sound, and speak up when something is missing."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted(path for path in [*(ROOT / "scripts").iterdir(), ROOT / ".ci" / "run"] if path.is_file())


def run(command: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command with a changed environment and return how it ended."""
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment}, timeout=60)


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="scripts/install --dev installs shellcheck")
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_shellcheck_finds_nothing(script: Path) -> None:
    done = run(["shellcheck", str(script)])
    assert done.stdout == ""
    assert done.returncode == 0


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_every_script_is_executable_and_stops_at_the_first_error(script: Path) -> None:
    assert os.access(script, os.X_OK)
    assert "set -euo pipefail" in script.read_text(encoding="utf-8")


def test_an_unknown_option_shows_how_to_use_the_installer() -> None:
    done = run([str(ROOT / "scripts" / "install"), "--nonsense"])
    assert done.returncode == 2
    assert "scripts/install [--venv DIR] [--dev]" in done.stderr


def machine_without(tmp_path: Path, *missing: str) -> Path:
    """Return a folder of commands like this machine's, without apt-get, Python and what else is `missing`."""
    commands = tmp_path / "bin"
    commands.mkdir()
    for name in ("bash", "dirname", "uname", "env", "cat", "cut", "sha256sum", "sed"):
        if name not in missing:
            (commands / name).symlink_to(str(shutil.which(name)))
    no_library = commands / "ldconfig"
    no_library.write_text("#!/bin/sh\necho libGL.so.1 libX11.so.6 libusb-1.0.so.0 libgomp.so.1\n")
    no_library.chmod(0o755)
    return commands


def test_a_missing_library_without_apt_is_named(tmp_path: Path) -> None:
    commands = machine_without(tmp_path)
    (commands / "python3.11").symlink_to(str(shutil.which("python3")))
    done = run([str(ROOT / "scripts" / "install"), "--venv", str(tmp_path / "venv")], PATH=str(commands))
    assert done.returncode == 1
    assert "expected apt-get to install these packages, found none: libegl1" in done.stderr
    assert not (tmp_path / "venv").exists()
