"""Rewrite the lock files beside this: every package that an installation on Linux (x86-64) with Python 3.11 needs, with its digests.

Run by scripts/lock. Usage: update.py [--upgrade]; without it, what is locked stays where it still fits.
uv (of the same environment) asks the registry that its own settings name; the files name none.
"""

import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
PROJECT = FOLDER.parent / "pyproject.toml"
TORCH = "torch"
_HEADER = "# Written by scripts/lock: {what}. Install with --require-hashes --no-deps.\n"
_WHAT = {
    "torch": "the CPU build of PyTorch, for installations that bring no build of their own",
    "service": "what the service needs beside PyTorch, and what builds its wheel",
    "ray": "what workers on several machines need, beside service.txt",
    "console": "what builds the console, on its own",
    "dev": "what the tests need, beside service.txt, ray.txt and console.txt",
    "sbom": "what scripts/sbom needs, beside all others",
}
_EXTRAS = {
    "service": [],
    "ray": ["ray"],
    "console": ["console"],
    "dev": ["ray", "console", "dev"],
    "sbom": ["ray", "console", "dev", "sbom"],
}
"""The extras that each file is for; it holds what the files before it lack."""

Packages = dict[str, str]
"""The lines of each package, by its name and version (`numpy==2.4.6`)."""


def main(arguments: list[str]) -> str | None:
    """Rewrite the files; return what went wrong, None when nothing did."""
    if arguments not in ([], ["--upgrade"]):
        return f"expected --upgrade or nothing, got {arguments}"
    known = "" if arguments else "".join(path.read_text(encoding="utf-8") for path in sorted(FOLDER.glob("*.txt")))
    everything = resolve(["ray", "console", "dev", "sbom"], known)
    torch = next(name for name in everything if name.startswith(f"{TORCH}=="))
    if not torch.endswith("+cpu"):
        return f"expected a CPU build of PyTorch, got {torch}; name a place that has one in UV_FIND_LINKS or UV_INDEX"
    # What two files share has one version: each choice is made among the packages of the largest.
    locked = "".join(everything.values())
    written = {torch}
    write("torch", {torch: everything[torch]})
    for name, extras in _EXTRAS.items():
        found = resolve(extras, locked)
        write(name, {package: lines for package, lines in found.items() if package not in written})
        written |= found.keys()
    return None


def resolve(extras: list[str], known: str) -> Packages:
    """Return the packages of the project with `extras` and of its build system. known: lines whose versions are kept."""
    with tempfile.TemporaryDirectory() as folder:
        build = Path(folder, "build.in")
        build.write_text("\n".join(tomllib.loads(PROJECT.read_text(encoding="utf-8"))["build-system"]["requires"]))
        output = Path(folder, "locked.txt")
        output.write_text(known, encoding="utf-8")
        command = ["uv", "pip", "compile", "--quiet", "--generate-hashes", "--no-header", "--no-annotate"]
        command += ["--python-version", "3.11", "--python-platform", "x86_64-manylinux_2_35"]
        command += [f"--extra={extra}" for extra in extras]
        subprocess.run([*command, "--output-file", str(output), str(PROJECT), str(build)], check=True)
        return packages(output.read_text(encoding="utf-8"))


def packages(text: str) -> Packages:
    """Return the packages of a lock file."""
    found = re.findall(r"^(\S+==\S+)( \\\n(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", text, re.MULTILINE)
    return {name: name + lines for name, lines in found}


def write(name: str, content: Packages) -> None:
    """Write one of the files."""
    text = _HEADER.format(what=_WHAT[name]) + "".join(content[each] for each in sorted(content))
    FOLDER.joinpath(f"{name}.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
