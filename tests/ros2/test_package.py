"""The package as colcon builds it, and the same parameters in code, file, command and documentation."""

import ast
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
import typer
from typer.testing import CliRunner

from panoloc.ros2.command import add_to
from panoloc.ros2.parameters import explained

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "clients" / "ros2"


def test_the_parameters_of_the_file_and_of_the_page_are_those_of_the_code() -> None:
    values = {
        name: str(default).lower() if isinstance(default, bool) else str(default) for name, default, _ in explained()
    }
    file = (PACKAGE / "config" / "params.yaml").read_text(encoding="utf-8")
    in_file = dict(re.findall(r'^    (\w+): "?([^"\n]*)"?$', file, re.MULTILINE))
    assert {"map": ""} | in_file == values
    page = (ROOT / "docs" / "ros2.md").read_text(encoding="utf-8")
    _, _, page = page.partition("## Parameters")
    page, _, _ = page.partition("## What it does")
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.+) \|$", page, re.MULTILINE)
    assert rows == [(name, f"`{values[name]}`" if values[name] else "", meaning) for name, _, meaning in explained()]


def test_the_package_runs_on_the_python_of_ros_humble() -> None:
    for path in PACKAGE.rglob("*.py"):
        ast.parse(path.read_text(encoding="utf-8"), path.name, feature_version=(3, 10))


def test_modules_of_the_node_need_numpy_alone() -> None:
    """What the manifest names, and nothing that only the Python distribution of panoloc has."""
    names: set[str] = set()
    for path in (PACKAGE / "panoloc_ros2").glob("*.py"):
        if path.stem in ("command", "dds", "messages"):  # the transport without ROS
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {each.name.partition(".")[0] for each in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add((node.module or "").partition(".")[0])
    manifest = ElementTree.parse(PACKAGE / "package.xml")
    needed = {each.text.removeprefix("python3-") for each in manifest.findall("exec_depend") if each.text}
    assert names - set(sys.stdlib_module_names) <= needed


@pytest.mark.slow
def test_colcon_finds_manifest_marker_launch_file_and_executable(tmp_path: Path) -> None:
    source = tmp_path / "source"
    shutil.copytree(PACKAGE, source, ignore=shutil.ignore_patterns("__pycache__"))
    program = "import setuptools.build_meta as backend; backend.build_wheel('out')"
    subprocess.run([sys.executable, "-c", program], cwd=source, check=True, capture_output=True, timeout=120)
    (wheel,) = (source / "out").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (scripts,) = (name for name in names if name.endswith("entry_points.txt"))
        assert "panoloc = panoloc_ros2.node:main" in archive.read(scripts).decode()
    share = {name.partition(".data/data/")[2] for name in names if ".data/data/" in name}
    assert share == {
        "share/ament_index/resource_index/packages/panoloc_ros2",
        "share/panoloc_ros2/package.xml",
        "share/panoloc_ros2/launch/panoloc.launch.py",
        "share/panoloc_ros2/config/params.yaml",
    }
    modules = {f"panoloc_ros2/{path.name}" for path in (PACKAGE / "panoloc_ros2").glob("*.py")}
    assert modules <= names


def test_the_command_has_an_option_for_every_parameter_and_asks_for_a_map() -> None:
    program = typer.Typer()
    program.callback()(lambda: None)
    add_to(program)
    (command,) = typer.main.get_command(program).commands.values()  # type: ignore[attr-defined]
    options = {each.name: each.default for each in command.params}
    assert options == {name: default for name, default, _ in explained()}
    assert all(each.help for each in command.params)
    done = CliRunner().invoke(program, ["ros2"])
    assert done.exit_code == 2
    assert "expected the id of a map" in " ".join(done.output.replace("│", " ").split())
