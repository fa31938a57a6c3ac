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


PIP = """#!/usr/bin/env bash
# A Python of which the installer asks three things (its version, its machine, whether it has PyTorch), and its pip.
case "$*" in
  *find_spec*) exit 1 ;;
  *platform*) echo Linux x86_64 3 11 ;;
  "-c "*) exit 0 ;;
  *requirements/torch.txt*) echo "$TORCH_SAYS" >&2; [[ -z $TORCH_SAYS ]] ;;
esac && echo "$*" >>installed
"""


@pytest.fixture
def installer(tmp_path: Path) -> Path:
    """Return a copy of the project's installer on a machine with few commands, whose pip is the one above."""
    for name in ("scripts", "requirements"):
        shutil.copytree(ROOT / name, tmp_path / name)
    for name in ("pyproject.toml", "setup.py"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(ROOT / "core" / "kernels", tmp_path / "core" / "kernels")
    commands = tmp_path / "bin"
    commands.mkdir()
    for name in ("bash", "dirname", "uname", "env", "cat", "cut", "sha256sum", "sed", "grep", "tr", "find", "rm"):
        (commands / name).symlink_to(str(shutil.which(name)))
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    (commands / "python3.11").symlink_to(python)
    libraries = "#!/bin/sh\necho libGL.so.1 libEGL.so.1 libX11.so.6 libusb-1.0.so.0 libgomp.so.1\n"
    made = {python: PIP, commands / "ldconfig": libraries}
    made |= dict.fromkeys((commands / "g++", tmp_path / "scripts" / "build-console"), "#!/bin/sh\n")
    for path, text in made.items():
        path.write_text(text, encoding="utf-8")
        path.chmod(0o755)
    return tmp_path / "scripts" / "install"


def test_a_missing_library_without_apt_is_named(installer: Path) -> None:
    (installer.parents[1] / "bin" / "ldconfig").write_text("#!/bin/sh\necho libGL.so.1 libX11.so.6 libusb-1.0.so.0\n")
    done = run([str(installer), "--venv", "venv"], PATH=str(installer.parents[1] / "bin"))
    assert done.returncode == 1
    assert "expected apt-get to install these packages, found none: libegl1" in done.stderr


@pytest.mark.parametrize(
    ("pip_says", "code", "said"),
    [
        ("", 0, ""),
        ("ERROR: No matching distribution found for torch==2.13.0+cpu", 0, "pip finds no CPU build of PyTorch here"),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE.", 1, "DO NOT MATCH THE HASHES"),
    ],
    ids=["all is there", "no CPU build", "another digest"],
)
def test_everything_but_the_project_itself_is_installed_by_its_digest(
    installer: Path, pip_says: str, code: int, said: str
) -> None:
    top = installer.parents[1]
    done = run([str(installer)], PATH=str(top / "bin"), TORCH_SAYS=pip_says)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert done.stdout == ("Start the service: .venv/bin/panoloc serve\n" if code == 0 else "")
    record = top / "installed"
    installed = [line for line in record.read_text().splitlines() if "pip install" in line] if record.exists() else []
    assert any(line.endswith("-e .") for line in installed) == (code == 0)
    if not pip_says:
        assert all("--require-hashes --no-deps" in line for line in installed[:-1])
        files = {word for line in installed for word in line.split() if word.endswith(".txt")}
        assert files == {"requirements/service.txt", "requirements/torch.txt"}


@pytest.mark.parametrize("are_there", [True, False])
def test_kernels_that_are_missing_are_built_again_and_said_to_be_missing_where_that_fails(
    installer: Path, are_there: bool
) -> None:
    top = installer.parents[1]
    kernels, record = top / "core" / "kernels" / "_baseline.so", top / "installed"
    environment = {"PATH": str(top / "bin"), "TORCH_SAYS": ""}
    run([str(installer)], **environment)
    record.unlink()
    if are_there:
        kernels.write_bytes(b"built")
    done = run([str(installer)], **environment)
    assert done.returncode == 0, done.stderr
    assert record.exists() != are_there
    assert kernels.exists() == are_there
    assert ("could not be compiled" in done.stderr) != are_there
