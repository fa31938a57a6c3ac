"""The files for several front doors: the compose file, the proxy's configuration, the Kubernetes manifests."""

import http.server
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from docs.settings_table import settings_table
from tests.integration.proxy import NGINX, missing_tool, proxy_before

yaml = pytest.importorskip("yaml")
ROOT = Path(__file__).resolve().parents[2]
COMPOSE = ROOT / "docker" / "compose.front-doors.yaml"
MANIFESTS = ROOT / "docker" / "kubernetes" / "panoloc.yaml"


def manifests() -> list[dict[str, Any]]:
    return list(yaml.safe_load_all(MANIFESTS.read_text(encoding="utf-8")))


def manifest(kind: str, name: str) -> dict[str, Any]:
    (found,) = [each for each in manifests() if each["kind"] == kind and each["metadata"]["name"] == name]
    return found


def test_kubernetes_takes_every_manifest_without_a_field_that_it_does_not_know() -> None:
    validation = pytest.importorskip("kubernetes_validate")
    for each in manifests():
        validation.validate(each, "1.31", strict=True)


def test_the_manifests_name_each_other() -> None:
    pod = manifest("Deployment", "panoloc")["spec"]["template"]
    for kind, name in (("PodDisruptionBudget", "panoloc"), ("Deployment", "panoloc")):
        wanted = manifest(kind, name)["spec"]["selector"]["matchLabels"]
        assert wanted.items() <= pod["metadata"]["labels"].items()
    assert manifest("Service", "panoloc")["spec"]["selector"].items() <= pod["metadata"]["labels"].items()
    redis = manifest("Deployment", "panoloc-redis")["spec"]["template"]["metadata"]["labels"]
    assert manifest("Service", "panoloc-redis")["spec"]["selector"].items() <= redis.items()
    assert manifest("NetworkPolicy", "panoloc-redis")["spec"]["podSelector"]["matchLabels"].items() <= redis.items()
    claims = [each["persistentVolumeClaim"]["claimName"] for each in pod["spec"]["volumes"] if "emptyDir" not in each]
    assert claims == [manifest("PersistentVolumeClaim", "panoloc-data")["metadata"]["name"]]
    volumes = {each["name"] for each in pod["spec"]["volumes"]}
    assert {each["name"] for each in pod["spec"]["containers"][0]["volumeMounts"]} == volumes
    for name in ("panoloc", "panoloc-queries"):
        (rule,) = manifest("Ingress", name)["spec"]["rules"]
        assert {path["backend"]["service"]["name"] for path in rule["http"]["paths"]} == {"panoloc"}


def test_front_doors_share_one_folder_and_one_redis() -> None:
    settings = manifest("ConfigMap", "panoloc")["data"]
    assert settings["PANOLOC_SHARED"] == "true"
    assert settings["PANOLOC_REDIS_URL"].startswith("redis://panoloc-redis:")
    assert manifest("PersistentVolumeClaim", "panoloc-data")["spec"]["accessModes"] == ["ReadWriteMany"]
    services = yaml.safe_load(COMPOSE.read_text(encoding="utf-8"))["services"]
    doors = [service for name, service in services.items() if name.startswith("front-door-")]
    assert len(doors) == 3
    assert all(door == doors[0] for door in doors)
    assert doors[0]["environment"]["PANOLOC_SHARED"] == "true"
    assert doors[0]["volumes"] == ["scans:/data"]


@pytest.mark.parametrize("file", [COMPOSE, NGINX, MANIFESTS], ids=lambda file: file.name)
def test_every_setting_that_is_named_is_one(file: Path) -> None:
    known = set(re.findall(r"PANOLOC_[A-Z_]+", settings_table()))
    assert set(re.findall(r"PANOLOC_[A-Z_]+", file.read_text(encoding="utf-8"))) - {"PANOLOC_"} <= known


def test_a_front_door_may_finish_before_it_is_killed() -> None:
    spec = manifest("Deployment", "panoloc")["spec"]["template"]["spec"]
    drain_s = int(manifest("ConfigMap", "panoloc")["data"]["PANOLOC_DRAIN_S"])
    assert spec["terminationGracePeriodSeconds"] >= drain_s + 15
    services = yaml.safe_load(COMPOSE.read_text(encoding="utf-8"))["services"]
    assert services["front-door-1"]["stop_grace_period"] == "60s"


def test_only_queries_are_sent_again() -> None:
    annotation = "nginx.ingress.kubernetes.io/proxy-next-upstream"
    assert "non_idempotent" in manifest("Ingress", "panoloc-queries")["metadata"]["annotations"][annotation]
    assert "non_idempotent" not in manifest("Ingress", "panoloc")["metadata"]["annotations"][annotation]
    (rule,) = manifest("Ingress", "panoloc-queries")["spec"]["rules"]
    assert {path["path"] for path in rule["http"]["paths"]} == {"/localize", "/geopose"}


class FrontDoor:
    """Stands for one behind the proxy: it answers, or dies with the request in its hands."""

    def __init__(self) -> None:
        self.bodies: list[bytes] = []
        self.is_dying = False
        door = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_error(404)

            def do_POST(self) -> None:
                door.bodies.append(self.rfile.read(int(self.headers.get("Content-Length", 0))))
                if door.is_dying:
                    self.connection.close()
                    return
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, format: str, *args: object) -> None:
                """Say nothing."""

        class Server(http.server.ThreadingHTTPServer):
            def handle_error(self, request: object, client_address: object) -> None:
                """Die quietly."""

        self.server = Server(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.server.server_port}"


@pytest.fixture
def proxied(tmp_path: Path) -> Iterator[tuple[httpx.Client, list[FrontDoor]]]:
    """Run the proxy as it is configured, before three front doors of ours."""
    if (tool := missing_tool()) is not None:
        pytest.skip(f"needs {tool} from apt")
    doors = [FrontDoor() for _ in range(3)]
    try:
        with (
            proxy_before([door.address for door in doors], tmp_path) as proxy,
            httpx.Client(base_url=proxy.url, verify=proxy.context, timeout=90) as client,
        ):
            yield client, doors
    finally:
        for door in doors:
            door.server.shutdown()
            door.server.server_close()


@pytest.mark.slow
def test_a_query_in_the_hands_of_a_front_door_that_dies_is_answered_by_another(
    proxied: tuple[httpx.Client, list[FrontDoor]],
) -> None:
    client, doors = proxied
    image = bytes(range(256)) * 20_000
    doors[0].is_dying = doors[1].is_dying = True
    for _ in range(6):
        assert client.post("/localize", files={"image": image}).status_code == 200
    assert doors[0].bodies or doors[1].bodies, "nobody died"
    assert all(image in body for door in doors for body in door.bodies)
    assert len(doors[2].bodies) == 6


@pytest.mark.slow
def test_an_upload_in_the_hands_of_a_front_door_that_dies_is_not_repeated(
    proxied: tuple[httpx.Client, list[FrontDoor]],
) -> None:
    client, doors = proxied
    for door in doors:
        door.is_dying = True
    assert client.post("/maps", files={"file": b"a scan"}).status_code == 502
    assert sum(len(door.bodies) for door in doors) == 1


@pytest.mark.slow
def test_a_front_door_that_is_gone_is_passed_over(proxied: tuple[httpx.Client, list[FrontDoor]]) -> None:
    client, doors = proxied
    for door in doors[:2]:
        door.server.shutdown()
        door.server.server_close()
    for path in ("/maps", "/localize", "/batches"):
        assert client.post(path, files={"file": b"a scan"}).status_code == 200
    assert len(doors[2].bodies) == 3
