"""The OpenAPI document: complete, with examples, and true (schemathesis calls every operation)."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings

from panoloc.service.app import create_app
from panoloc.service.cache import WorkerCache
from panoloc.service.host.demo_room import DEMO_FILES
from panoloc.service.settings import Settings
from panoloc.service.storage import FolderStorage
from tests.service.http.fake_pool import FakePool
from tests.service.http.running_service import SCAN, Listen

CONTRACT = {
    "/maps": {"get", "post"},
    "/maps/{map_id}": {"get", "patch", "delete"},
    "/maps/{map_id}/scan": {"put"},
    "/maps/{map_id}/preview.png": {"get"},
    "/maps/{map_id}/points": {"get"},
    "/maps/{map_id}/starts": {"get"},
    "/maps/{map_id}/links": {"post"},
    "/localize": {"post"},
    "/localizations/{localization_id}": {"get", "delete"},
    "/localizations/{localization_id}/score-map-2d.png": {"get"},
    "/localizations/{localization_id}/score-map-3d.png": {"get"},
    "/localizations/{localization_id}/overlay.png": {"get"},
    "/batches": {"get", "post"},
    "/batches/{batch_id}": {"get", "patch", "delete"},
    "/batches/{batch_id}/export": {"get"},
    "/batches/{batch_id}/plan.png": {"get"},
    "/geopose": {"post"},
    "/{map_id}/localize/image": {"post"},
    "/{map_id}/capabilities": {"get"},
    "/health/live": {"get"},
    "/health/ready": {"get"},
    "/health": {"get"},
    "/metrics": {"get"},
}


def document_of(folder: Path) -> dict[str, Any]:
    unused = "unix:///tmp/no-redis-here"
    pool = FakePool(WorkerCache(unused, index_lifetime_s=60))
    app = create_app(Settings(data_dir=folder, redis_url=unused), pool)
    return app.openapi()


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return document_of(Path("unused"))


def operations_of(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield path, method and operation."""
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def test_every_call_of_the_contract_is_described(document: dict[str, Any]) -> None:
    described = {path: set(methods) for path, methods in document["paths"].items()}
    assert CONTRACT.items() <= described.items()


def test_every_error_is_a_problem_document_with_an_example(document: dict[str, Any]) -> None:
    for path, method, operation in operations_of(document):
        for status, response in operation["responses"].items():
            if int(status) < 400 or path == "/health/ready":
                continue
            (media,) = response["content"].items()
            assert media[0] == "application/problem+json", (method, path, status)
            assert media[1]["schema"] == {"$ref": "#/components/schemas/ProblemDocument"}, (method, path, status)
            assert media[1]["examples"], (method, path, status)
            assert response["description"], (method, path, status)


def test_every_answer_in_json_has_an_example(document: dict[str, Any]) -> None:
    for path, method, operation in operations_of(document):
        assert operation["summary"], (method, path)
        for status, response in operation["responses"].items():
            media = response.get("content", {}).get("application/json")
            if media and int(status) < 300 and path.startswith(("/maps", "/locali")):
                assert media.get("example") or media.get("examples"), (method, path, status)


def test_retry_after_is_documented(document: dict[str, Any]) -> None:
    for path, method, operation in operations_of(document):
        for status in {"429", "503"} & operation["responses"].keys():
            assert "Retry-After" in operation["responses"][status]["headers"], (method, path, status)


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    def references(node: Any) -> Any:
        if isinstance(node, dict):
            yield from ([node["$ref"]] if isinstance(node.get("$ref"), str) else [])
            node = list(node.values())
        for inner in node if isinstance(node, list) else []:
            yield from references(inner)

    known = {f"#/components/schemas/{name}" for name in document["components"]["schemas"]}
    found = set(references(document))
    assert found <= known
    assert "#/components/schemas/LocalizeOptions" in found


@pytest.mark.slow
@pytest.mark.unwatched
def test_the_service_does_what_its_document_says(tmp_path: Path, listen: Listen) -> None:
    import schemathesis  # here, because every process that shares the tests imports this file

    for name in DEMO_FILES:  # a room takes longer to make than this test may wait
        FolderStorage(tmp_path).put(f"demo/{name}", b"made before")
    with listen() as url:
        map_id = httpx.post(f"{url}/maps", files={"file": ("a.ply", SCAN)}).json()["id"]
        schema = schemathesis.openapi.from_url(f"{url}/openapi.json")
        seen = {}
        for found in schema.get_all_operations():
            operation = found.ok()
            # Deleting the only map would leave nothing but 404 to see.
            known_id = None if operation.method == "delete" else map_id
            seen[operation.label] = statuses_of(operation, known_id)
    assert {202, 404, 415, 422} & seen["POST /maps"]
    for name in ("PATCH /maps/{map_id}", "GET /maps/{map_id}", "GET /maps/{map_id}/points", "GET /maps"):
        assert 200 in seen[name], (name, seen[name])


def statuses_of(operation: Any, map_id: str | None) -> set[int]:
    """Call an operation with generated input, with the id of a real map two times of three; return what came."""
    from schemathesis.checks import not_a_server_error
    from schemathesis.specs.openapi import checks

    promised = (
        not_a_server_error,
        checks.status_code_conformance,
        checks.content_type_conformance,
        checks.response_schema_conformance,
        checks.response_headers_conformance,
    )
    seen: set[int] = set()
    turn = itertools.cycle([True, True, False])

    @settings(max_examples=6, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(case=operation.as_strategy())
    def answers_as_documented(case: Any) -> None:
        if next(turn) and map_id and "map_id" in (case.path_parameters or {}):
            case.path_parameters["map_id"] = map_id
        seen.add(case.call_and_validate(checks=promised).status_code)

    answers_as_documented()
    return seen


def test_every_operation_of_the_api_says_how_it_refuses_unknown_query_parameters(document: dict[str, Any]) -> None:
    of_api = [operation for *_, operation in operations_of(document) if operation["tags"] != ["operations"]]
    assert len(of_api) > 30
    assert [each["operationId"] for each in of_api if "422" not in each["responses"]] == []
