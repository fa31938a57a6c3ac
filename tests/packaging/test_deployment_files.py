"""The image, the compose files, the Kubernetes manifests and the files of the monitoring fit the project and each other."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from docs.settings_table import settings_table
from panoloc.service.jobs import PoolState
from panoloc.service.metrics import Metrics

yaml = pytest.importorskip("yaml")
ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
KUBERNETES = DOCKER / "kubernetes"
COMPOSE = sorted(DOCKER.glob("compose*.yaml"))


class Compose(yaml.SafeLoader):  # type: ignore[misc,name-defined]  # there are no types for yaml here
    """Reads compose files, which may take back what another one sets."""


Compose.add_constructor("!reset", lambda loader, node: None)


def read(path: Path) -> Any:
    """Return the content of a YAML file."""
    return yaml.load(path.read_text(encoding="utf-8"), Compose)


def manifests() -> list[dict[str, Any]]:
    """Return everything that the base makes."""
    files = read(KUBERNETES / "base" / "kustomization.yaml")["resources"]
    return [
        each for file in files for each in yaml.safe_load_all((KUBERNETES / "base" / file).read_text(encoding="utf-8"))
    ]


def manifest(kind: str, name: str) -> dict[str, Any]:
    (found,) = [each for each in manifests() if each["kind"] == kind and each["metadata"]["name"] == name]
    return found


def test_everything_that_the_image_copies_exists_and_is_not_ignored() -> None:
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = [
        word.rstrip("/")
        for line in re.findall(r"^COPY (?!--from)(.+)$", dockerfile, re.MULTILINE)
        for word in line.split()[:-1]
    ]
    assert copied
    for name in copied:
        assert (ROOT / name).exists()
        assert {name, *map(str, Path(name).parents)} & kept, name


@pytest.mark.parametrize("file", COMPOSE, ids=lambda file: file.name)
def test_the_compose_files_mount_and_read_what_exists(file: Path) -> None:
    services = read(file)["services"].values()
    mounted = [volume.split(":")[0] for service in services for volume in service.get("volumes", [])]
    named = [entry for service in services for entry in service.get("env_file", []) if entry == "compose.env"]
    for source in [*(each for each in mounted if each.startswith("./")), *named]:
        assert (DOCKER / source).exists(), source


def test_nothing_but_the_proxy_is_reached_from_other_machines() -> None:
    services = [item for file in COMPOSE for item in read(file)["services"].items()]
    ports = [(name, port) for name, service in services for port in service.get("ports") or []]
    assert {name for name, port in ports if not port.startswith("127.0.0.1:")} == {"proxy"}
    assert {name for name, _ in ports} == {"proxy", "panoloc", "prometheus", "grafana"}


@pytest.mark.parametrize(
    "file",
    [*COMPOSE, DOCKER / "compose.env", DOCKER / "nginx" / "nginx.conf", KUBERNETES / "base" / "panoloc.yaml"],
    ids=lambda file: file.name,
)
def test_every_setting_that_is_named_is_one(file: Path) -> None:
    known = set(re.findall(r"PANOLOC_[A-Z_]+", settings_table()))
    of_compose = {"PANOLOC_PUBLISHED_PORT", "PANOLOC_METRICS_KEY"}
    assert set(re.findall(r"PANOLOC_[A-Z_]+", file.read_text(encoding="utf-8"))) - of_compose <= known


def test_kubernetes_takes_every_manifest_without_a_field_that_it_does_not_know() -> None:
    validation = pytest.importorskip("kubernetes_validate")
    for each in manifests():
        validation.validate(each, "1.31", strict=True)


def test_the_overlay_changes_what_is_in_the_base() -> None:
    patch = read(KUBERNETES / "gpu" / "deployment.yaml")
    (container,) = patch["spec"]["template"]["spec"]["containers"]
    pod = manifest(patch["kind"], patch["metadata"]["name"])["spec"]["template"]["spec"]
    assert container["name"] in [each["name"] for each in pod["containers"]]


def test_the_manifests_name_each_other() -> None:
    pod = manifest("Deployment", "panoloc")["spec"]["template"]
    labels = pod["metadata"]["labels"].items()
    for kind in ("PodDisruptionBudget", "Deployment"):
        assert manifest(kind, "panoloc")["spec"]["selector"]["matchLabels"].items() <= labels
    assert manifest("Service", "panoloc")["spec"]["selector"].items() <= labels
    redis = manifest("Deployment", "panoloc-redis")["spec"]["template"]["metadata"]["labels"].items()
    assert manifest("Service", "panoloc-redis")["spec"]["selector"].items() <= redis
    policy = manifest("NetworkPolicy", "panoloc-redis")["spec"]
    assert policy["podSelector"]["matchLabels"].items() <= redis
    assert policy["ingress"][0]["from"][0]["podSelector"]["matchLabels"].items() <= labels
    claims = [each["persistentVolumeClaim"]["claimName"] for each in pod["spec"]["volumes"] if "emptyDir" not in each]
    assert claims == [manifest("PersistentVolumeClaim", "panoloc-data")["metadata"]["name"]]
    volumes = {each["name"] for each in pod["spec"]["volumes"]}
    assert {each["name"] for each in pod["spec"]["containers"][0]["volumeMounts"]} == volumes
    for name in ("panoloc", "panoloc-queries"):
        (rule,) = manifest("Ingress", name)["spec"]["rules"]
        assert {path["backend"]["service"]["name"] for path in rule["http"]["paths"]} == {"panoloc"}


def test_a_replica_may_finish_before_it_is_killed() -> None:
    drain_s = int(manifest("ConfigMap", "panoloc")["data"]["PANOLOC_DRAIN_S"])
    assert (
        manifest("Deployment", "panoloc")["spec"]["template"]["spec"]["terminationGracePeriodSeconds"] >= drain_s + 15
    )
    assert read(DOCKER / "compose.yaml")["services"]["panoloc"]["stop_grace_period"] == "60s"


def test_only_queries_are_sent_again() -> None:
    annotation = "nginx.ingress.kubernetes.io/proxy-next-upstream"
    assert "non_idempotent" in manifest("Ingress", "panoloc-queries")["metadata"]["annotations"][annotation]
    assert "non_idempotent" not in manifest("Ingress", "panoloc")["metadata"]["annotations"][annotation]
    (rule,) = manifest("Ingress", "panoloc-queries")["spec"]["rules"]
    assert {path["path"] for path in rule["http"]["paths"]} == {"/localize", "/geopose"}


def test_dashboard_and_alerts_ask_only_for_metrics_that_the_service_has() -> None:
    metrics = Metrics(lambda: PoolState(ready=True, waiting_for=None), dict)
    metrics.note_request("GET", "/maps", 200, 0.1)
    metrics.note_localization("fast", "localized", {"total": 0.1})
    metrics.note_registration("failed", 1.0)
    offered = set(re.findall(r"^(\w+)[{ ]", metrics.text().decode(), re.MULTILINE))
    dashboard = json.loads((DOCKER / "grafana" / "dashboards" / "panoloc.json").read_text(encoding="utf-8"))
    shown = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    rules = [rule for group in read(DOCKER / "prometheus" / "alerts.yaml")["groups"] for rule in group["rules"]]
    for expressions in (shown, [rule["expr"] for rule in rules]):
        named = {name for text in expressions for name in re.findall(r"\b(?:panoloc|process)_\w+", text)}
        assert len(named) > 3
        assert named - offered == set()
