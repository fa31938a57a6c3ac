"""Every exception of both trees has its problem, and nothing else does."""

import inspect

import pytest

import panoloc.core.errors
import panoloc.service.errors
from panoloc.core.errors import CoreError, PanoramaShapeError, PanoramaUnusableError
from panoloc.service.errors import InvalidOptionsError, QueueFullError, RequestError, StorageError, WorkerError
from panoloc.service.problems import CORE_PROBLEMS, error_responses, known_problems, problem_document, problem_of

TREES = {
    panoloc.service.errors: panoloc.service.errors.ServiceError,
    panoloc.core.errors: panoloc.core.errors.CoreError,
}
KINDS = {
    kind
    for module, base in TREES.items()
    for _, kind in inspect.getmembers(module, inspect.isclass)
    if issubclass(kind, base)
}


def kind_of(kind: type[Exception]) -> Exception:
    return kind.__new__(kind)


OF_UPLOADS = sorted((kind for kind in KINDS if kind.__name__.startswith(("Mask", "Panorama"))), key=str)


def test_every_exception_has_a_problem_of_its_own() -> None:
    own = {kind for kind in KINDS if "problem" in vars(kind)}
    assert own | set(CORE_PROBLEMS) | set(StorageError.__subclasses__()) | {RequestError} == KINDS


def test_a_slug_means_one_thing() -> None:
    by_slug: dict[str, set[object]] = {}
    for kind in KINDS:
        by_slug.setdefault(problem_of(kind_of(kind)).slug, set()).add(problem_of(kind_of(kind)))
    assert all(len(meanings) == 1 for meanings in by_slug.values())


@pytest.mark.parametrize("problem", known_problems().values(), ids=lambda problem: problem.slug)
def test_a_problem_says_what_to_do(problem: object) -> None:
    assert problem.advice.endswith(".")  # type: ignore[attr-defined]
    assert 400 <= problem.status <= 599  # type: ignore[attr-defined]


def test_an_exception_of_core_is_a_problem_of_the_caller_and_a_fault_of_a_worker_is_ours() -> None:
    assert problem_of(PanoramaShapeError("")).status == 422
    # The console asks how wide a photo sees where the slug is the other one.
    assert problem_of(PanoramaUnusableError("")).slug == "image-unusable"
    assert problem_of(WorkerError("SomethingNewError", "")).status == 500


@pytest.mark.parametrize("kind", OF_UPLOADS, ids=lambda kind: kind.__name__)
def test_a_problem_of_an_upload_names_the_upload(kind: type[CoreError]) -> None:
    part = "mask" if "Mask" in kind.__name__ else "image"
    problem = CORE_PROBLEMS[kind]
    assert part in problem.title
    assert ("mask" in problem.slug) == (part == "mask")
    fields = problem_document(kind("expected this, got that"), "req_1")["fields"]
    assert fields == [{"field": part, "message": "expected this, got that"}]


def test_a_mask_gets_the_status_that_a_panorama_would_get() -> None:
    masks = [kind for kind in OF_UPLOADS if "Mask" in kind.__name__]
    assert len(masks) == 4
    for kind in masks:
        assert problem_of(kind_of(kind)).status == problem_of(kind_of(kind.__bases__[0])).status


def test_a_document_bears_message_and_request_id() -> None:
    error = InvalidOptionsError("top_k: too large", [{"field": "top_k", "message": "too large"}])
    assert problem_document(error, "req_1") == {
        "type": "/problems/invalid-options",
        "title": "The request cannot be used as it is",
        "status": 422,
        "detail": "top_k: too large",
        "request_id": "req_1",
        "fields": [{"field": "top_k", "message": "too large"}],
    }


@pytest.mark.parametrize("error", [ValueError("/root/key"), WorkerError("KeyError", "/root/key")])
def test_what_nobody_expected_is_not_told(error: Exception) -> None:
    document = problem_document(error, "req_1")
    assert document["status"] == 500
    assert "/root/key" not in document["detail"]


def test_a_documented_status_shows_each_kind_behind_it() -> None:
    examples = error_responses(503)[503]["content"]["application/problem+json"]["examples"]
    assert {"no-worker", "cache-down", "storage-full"} <= examples.keys()
    assert QueueFullError("full", 7).retry_after_s == 7
