"""The npm package against a real service: its examples do what they say, and content stays in place during a walk."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.integration.running_service import ROOT, RunningService
from tests.integration.small_room import OPTIONS, small_room
from tests.integration.walked_room import walk_with_tracker, write_walk
from tests.packaging.test_js_package import PACKAGE, node

pytestmark = pytest.mark.integration
TSC = PACKAGE / "node_modules" / "typescript" / "bin" / "tsc"
STRICT = (
    "--strict",
    "--noUncheckedIndexedAccess",
    "--target",
    "es2023",
    "--module",
    "nodenext",
    "--lib",
    "es2023,dom",
    "--noEmit",
)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a user's project, in which the package is installed."""
    project = tmp_path_factory.mktemp("project")
    installed = project / "node_modules" / "panoloc"
    installed.mkdir(parents=True)
    for name in ("three", "@types"):
        (project / "node_modules" / name).symlink_to(PACKAGE / "node_modules" / name)
    node(TSC, "-p", "tsconfig.build.json", "--outDir", installed / "dist")
    shutil.copy(PACKAGE / "package.json", installed)
    (project / "package.json").write_text('{"type": "module"}')
    return project


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk")
    write_walk(folder, seed=3, seconds=15, width=480)
    return folder


@pytest.fixture(scope="module")
def walked_map(service: RunningService, walk: Path) -> str:
    return service.register((walk / "scan.ply").read_bytes(), OPTIONS)


def examples(page: Path, service: RunningService, map_id: str) -> list[str]:
    """Return the code of a page, for this service and map."""
    blocks = re.findall(r"```ts\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    url = str(service.http.base_url)
    return [block.replace("http://127.0.0.1:8000", url).replace("map_…", map_id) for block in blocks]


def test_the_examples_hold_and_lead_to_a_pose_and_to_content_in_its_place(
    project: Path, service: RunningService, walk: Path, walked_map: str
) -> None:
    (readme,) = examples(PACKAGE / "README.md", service, walked_map)
    to_a_pose, *others = examples(ROOT / "docs" / "js.md", service, walked_map)
    for number, code in enumerate((readme, to_a_pose, *others)):
        (project / f"{number}.ts").write_text(code)
    files = sorted(path.name for path in project.glob("*.ts"))
    # What the package declares is checked without what three declares, which takes three times as long.
    own = ("--skipDefaultLibCheck", "--typeRoots", "dist", "dist/index.d.ts")
    node(TSC, *STRICT, *own, folder=project / "node_modules" / "panoloc")
    node(TSC, *STRICT, "--skipLibCheck", "--types", "node", *files, folder=project)

    (project / "office.ply").write_bytes(small_room().scan)
    (project / "photo.jpg").write_bytes(small_room().panorama)
    x, y, z = map(float, re.findall(r"[xyz]: (-?[\d.]+)", node("1.ts", folder=project)))
    assert np.linalg.norm(np.array([x, y, z]) - small_room().pose.position) < 0.05

    shown = json.loads(node(PACKAGE / "tests" / "example.ts", project / "0.ts", walk))
    assert shown["isShown"]
    assert shown["error_m"] < 0.1


def test_every_call_does_what_it_says(service: RunningService, map_id: str, tmp_path: Path) -> None:
    (tmp_path / "panorama.jpg").write_bytes(small_room().panorama)
    node("tests/calls.ts", str(service.http.base_url), map_id, tmp_path / "panorama.jpg")


def test_content_stays_in_place_while_somebody_walks(service: RunningService, walk: Path, walked_map: str) -> None:
    walked = walk_with_tracker(str(service.http.base_url), walked_map, walk, drift_seed=1)
    names = [name for name, _ in walked.events]
    assert names[0] == "located"
    assert set(names) <= {"located", "corrected"}
    assert walked.events[0][1] < 6
    assert walked.in_place >= 0.9, walked
