"""The lock files hold what pyproject.toml asks for, each package with its digests, and name no registry."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[2]
FILES = {path.stem: path for path in (ROOT / "requirements").glob("*.txt")}
LOCKED_FOR = {
    "sys_platform": "linux",
    "platform_system": "Linux",
    "platform_machine": "x86_64",
    "python_version": "3.11",
    "python_full_version": "3.11.0",
}
"""The lock files are for this."""


def wanted_by(*extras: str) -> list[Requirement]:
    """Return what the project needs, and its build and `extras` do, on what the lock files are for."""
    found = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lines = [*found["build-system"]["requires"], *found["project"]["dependencies"]]
    for extra in extras:
        lines += found["project"]["optional-dependencies"][extra]
    needed = map(Requirement, lines)
    return [each for each in needed if each.marker is None or each.marker.evaluate(LOCKED_FOR)]


def locked_in(*names: str) -> dict[str, Version]:
    """Return the versions in these files."""
    text = "".join(FILES[name].read_text(encoding="utf-8") for name in names)
    return {canonicalize_name(name): Version(version) for name, version in re.findall(r"^([\w.-]+)==(\S+)", text, re.M)}


@pytest.mark.parametrize(
    ("extras", "files"),
    [
        ([], ["torch", "service"]),
        (["ray"], ["torch", "service", "ray"]),
        (["console"], ["torch", "service", "console"]),
        (["ray", "console", "dev"], ["torch", "service", "ray", "console", "dev"]),
        (["ray", "console", "dev", "sbom"], ["torch", "service", "ray", "console", "dev", "sbom"]),
    ],
    ids=["installation", "Ray", "console", "tests", "bill of materials"],
)
def test_every_dependency_is_locked_at_a_version_that_fits(extras: list[str], files: list[str]) -> None:
    locked = locked_in(*files)
    unfit = [
        f"{need} is locked at {locked.get(canonicalize_name(need.name))}; run scripts/lock"
        for need in wanted_by(*extras)
        if (version := locked.get(canonicalize_name(need.name))) is None
        or not need.specifier.contains(version, prereleases=True)
    ]
    assert unfit == []


def test_no_package_is_in_two_files_that_are_installed_side_by_side() -> None:
    names = [name for file in FILES for name in locked_in(file)]
    assert sorted(names) == sorted(set(names))


@pytest.mark.parametrize("name", sorted(FILES))
def test_every_line_is_a_package_or_a_digest(name: str) -> None:
    text = FILES[name].read_text(encoding="utf-8")
    body = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("#"))
    package = r"[A-Za-z0-9][\w.-]*==[\w.+!-]+( \\\n    --hash=sha256:[0-9a-f]{64})+\n"
    assert re.fullmatch(f"({package})+", body)
    assert "://" not in text


def test_the_cpu_build_is_locked_and_brings_no_cuda() -> None:
    assert locked_in("torch")["torch"].local == "cpu"
    assert [name for name in locked_in(*FILES) if name.startswith("nvidia-")] == []
