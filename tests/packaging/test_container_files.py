"""The container image and the compose files fit the project."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from service.jobs import PoolState
from service.metrics import Metrics

yaml = pytest.importorskip("yaml")
ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"


def read(path: Path) -> Any:
    """Return the content of a YAML file."""
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def test_the_image_runs_as_a_user_without_rights_and_checks_its_health() -> None:
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    last_stage = dockerfile.rsplit("\nFROM ", 1)[1]
    user = re.search(r"^USER (\d+):(\d+)$", last_stage, re.MULTILINE)
    assert user is not None
    assert int(user[1]) > 0
    assert "HEALTHCHECK" in last_stage
    assert "/health/ready" in last_stage


def test_the_image_has_the_libraries_that_the_installer_installs() -> None:
    table = (ROOT / "scripts" / "install").read_text(encoding="utf-8").split("TABLE")[1]
    packages = [line.split()[0] for line in table.splitlines() if " lib" in line]
    assert len(packages) == 5
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert [package for package in packages if package not in dockerfile] == []


def test_everything_that_the_image_copies_exists_and_is_not_ignored() -> None:
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = [
        word for line in re.findall(r"^COPY (?!--from)(.+)$", dockerfile, re.MULTILINE) for word in line.split()[:-1]
    ]
    assert copied
    for name in copied:
        assert (ROOT / name).exists()
        assert {name, name.split("/")[0]} & kept


def test_the_compose_files_mount_what_exists() -> None:
    services = read(DOCKER / "compose.yaml")["services"]
    mounted = [volume.split(":")[0] for service in services.values() for volume in service.get("volumes", [])]
    for source in mounted:
        if source.startswith("."):
            assert (DOCKER / source).exists(), source
    assert services.keys() == {"panoloc", "redis", "prometheus", "grafana"}
    assert read(DOCKER / "compose.gpu.yaml")["services"].keys() == {"panoloc"}


def test_nothing_but_the_local_machine_reaches_a_published_port() -> None:
    services = read(DOCKER / "compose.yaml")["services"]
    ports = [port for service in services.values() for port in service.get("ports", [])]
    assert ports
    assert all(port.startswith("127.0.0.1:") for port in ports)


def test_the_monitoring_files_are_well_formed() -> None:
    for path in DOCKER.rglob("*.yaml"):
        documents = list(yaml.safe_load_all(path.read_text(encoding="utf-8")))
        assert documents, path
        assert all(documents), path
    for path in DOCKER.rglob("*.json"):
        assert json.loads(path.read_text(encoding="utf-8")), path


def test_the_dashboard_shows_only_metrics_that_the_service_has() -> None:
    metrics = Metrics(lambda: PoolState(ready=True, waiting_for=None), dict)
    metrics.note_request("GET", "/maps", 200, 0.1)
    metrics.note_localization("fast", "localized", {"total": 0.1})
    offered = set(re.findall(r"^(\w+)[{ ]", metrics.text().decode(), re.MULTILINE))
    dashboard = json.loads((DOCKER / "grafana" / "dashboards" / "panoloc.json").read_text(encoding="utf-8"))
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    shown = {name for text in expressions for name in re.findall(r"\b(?:panoloc|process)_\w+", text)}
    assert len(shown) > 10
    assert shown - offered == set()
