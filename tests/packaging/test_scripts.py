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
def test_shellcheck_finds_nothing() -> None:
    assert run(["shellcheck", *map(str, SCRIPTS)]).stdout == ""


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


PIP = """#!/usr/bin/env bash
# A Python of which the installer asks three things (its version, its machine, whether it has PyTorch), and its pip.
case "$*" in
  *find_spec*) exit 1 ;;
  *platform*) echo Linux x86_64 3 11 ;;
  "-c "*) exit 0 ;;
  *requirements/torch.txt*) echo "$TORCH_SAYS" >&2; [[ -z $TORCH_SAYS ]] ;;
esac && echo "$*" >>installed
"""


def install_where_pip_says(tmp_path: Path, of_torch: str) -> tuple[subprocess.CompletedProcess[str], list[str]]:
    """Run a copy of the installer whose pip says this of the locked PyTorch (nothing: it has it); return it and what pip installed."""
    for name in ("scripts", "requirements"):
        shutil.copytree(ROOT / name, tmp_path / name)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "scripts" / "build-console").write_text("#!/bin/sh\n", encoding="utf-8")
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(PIP, encoding="utf-8")
    python.chmod(0o755)
    commands = machine_without(tmp_path)
    for name in ("cat", "cut", "grep", "tr"):
        (commands / name).unlink(missing_ok=True)
        (commands / name).symlink_to(str(shutil.which(name)))
    (commands / "ldconfig").write_text(
        "#!/bin/sh\necho libGL.so.1 libEGL.so.1 libX11.so.6 libusb-1.0.so.0 libgomp.so.1\n"
    )
    (commands / "python3.11").symlink_to(python)
    done = run([str(tmp_path / "scripts" / "install")], PATH=str(commands), TORCH_SAYS=of_torch)
    record = tmp_path / "installed"
    return done, [line for line in record.read_text().splitlines() if "pip install" in line] if record.exists() else []


def test_everything_but_the_project_itself_is_installed_by_its_digest_and_without_ray_and_node(tmp_path: Path) -> None:
    done, installed = install_where_pip_says(tmp_path, "")
    assert done.returncode == 0, done.stderr
    *locked, project = installed
    assert all("--require-hashes --no-deps" in line for line in locked)
    assert {word for line in locked for word in line.split() if word.endswith(".txt")} == {
        "requirements/service.txt",
        "requirements/torch.txt",
    }
    assert project.endswith("-e .")


def test_where_pip_finds_no_cpu_build_it_chooses_one_that_fits_and_that_is_said(tmp_path: Path) -> None:
    done, installed = install_where_pip_says(tmp_path, "ERROR: No matching distribution found for torch==2.13.0+cpu")
    assert done.returncode == 0, done.stderr
    assert "pip finds no CPU build of PyTorch here (torch==" in done.stderr
    assert installed[-1].endswith("-e .")


def test_a_pytorch_whose_digest_differs_ends_the_installation(tmp_path: Path) -> None:
    done, installed = install_where_pip_says(
        tmp_path, "ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE."
    )
    assert done.returncode == 1
    assert "DO NOT MATCH THE HASHES" in done.stderr
    assert not any("-e ." in line for line in installed)
