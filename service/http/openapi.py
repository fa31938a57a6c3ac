"""The OpenAPI document: FastAPI's own, with the forms and bodies that routes read by themselves, and the answers and
problems of each path."""

import json
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, FastAPI, params
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from panoloc.service.answer import BY_STATUS, Localization
from panoloc.service.http.validation import check_query_parameters
from panoloc.service.problems import error_responses

Responses = dict[int | str, dict[str, Any]]

_REF = "#/components/schemas/{model}"
_MODELS: dict[str, type[BaseModel]] = {}
"""Models of forms and bodies, by name, as `json_part` has noted them: FastAPI does not know them."""

Router = partial(APIRouter, generate_unique_id_function=lambda route: route.name)
"""A router whose operations have the names of their functions as ids."""


def api_router(tag: str, *dependencies: params.Depends) -> APIRouter:
    """Return a router of a part of the API, which refuses query parameters that its operations do not know."""
    known = [Depends(check_query_parameters), *dependencies]
    return Router(tags=[tag], dependencies=known, responses=error_responses(422))


IDEMPOTENT_PATHS = frozenset(("/maps", "/localize", "/batches"))
"""Whose POST requests are done once for each `Idempotency-Key`."""

_IDEMPOTENCY_KEY = {
    "name": "Idempotency-Key",
    "in": "header",
    "required": False,
    "description": "Any text without spaces. The same request with the same key is not done again: its answer is sent again.",
    "schema": {"type": "string", "minLength": 1, "maxLength": 255, "pattern": "^[!-~]+$"},
}
_NULL = "\0null"  # FastAPI leaves nulls out, also of examples


def kept_nulls(example: Any) -> Any:
    """Return an example whose nulls survive FastAPI."""
    if isinstance(example, dict):
        return {key: kept_nulls(value) for key, value in example.items()}
    if isinstance(example, list):
        return [kept_nulls(value) for value in example]
    return _NULL if example is None else example


def binary_part(description: str) -> dict[str, Any]:
    """Return the schema of an uploaded file."""
    return {"type": "string", "format": "binary", "description": description}


def files_part(description: str, most: int) -> dict[str, Any]:
    """Return the schema of a part that may be repeated up to `most` times."""
    return {
        "type": "array",
        "items": {"type": "string", "format": "binary"},
        "maxItems": most,
        "description": description,
    }


def json_part(model: type[BaseModel]) -> dict[str, Any]:
    """Return the schema of a part that holds JSON."""
    _MODELS[model.__name__] = model
    return {"$ref": _REF.format(model=model.__name__)}


def multipart(
    parts: dict[str, Any], required: list[str], examples: dict[str, Any] | None = None, **constraint: Any
) -> dict[str, Any]:
    """Return the `openapi_extra` of a route that reads a multipart form. constraint: such as `oneOf`."""
    schema = {"type": "object", "properties": parts, "required": required, "additionalProperties": False, **constraint}
    encoding = {"options": {"contentType": "application/json"}} if "options" in parts else {}
    media: dict[str, Any] = {"schema": schema, "encoding": encoding}
    if examples:
        media["examples"] = kept_nulls(examples)
    return {"requestBody": {"required": True, "content": {"multipart/form-data": media}}}


def json_body(model: type[BaseModel], example: Any) -> dict[str, Any]:
    """Return the `openapi_extra` of a route that reads its JSON body itself."""
    content = {"application/json": {"schema": json_part(model), "example": kept_nulls(example)}}
    return {"requestBody": {"required": True, "content": content}}


def json_response(model: type[BaseModel], example: Any, *errors: int) -> Responses:
    """Return JSON with status 200. errors: statuses of problems."""
    content = {"application/json": {"example": kept_nulls(example)}}
    return {200: {"model": model, "content": content}, **error_responses(*errors)}


def path_header(path_of: str) -> dict[str, Any]:
    """Return a header that leads to something. path_of: its name."""
    return {"description": f"Path of the {path_of}", "required": True, "schema": {"type": "string"}}


def accepted_response(model: type[BaseModel], example: Any, description: str, path_of: str, *errors: int) -> Responses:
    """Return JSON with status 202. path_of: the name of what `Location` leads to."""
    headers = {
        "Location": path_header(path_of),
        "Retry-After": {
            "description": "Seconds to wait before the first poll",
            "required": True,
            "schema": {"type": "integer"},
        },
    }
    content = {"application/json": {"example": kept_nulls(example)}}
    accepted = {"model": model, "description": description, "headers": headers, "content": content}
    return {202: accepted, **error_responses(*errors)}


def file_response(description: str, media_types: tuple[str, ...], *errors: int) -> Responses:
    """Return bytes of one of these media types with status 200."""
    content = {kind: {"schema": {"type": "string", "format": "binary"}} for kind in media_types}
    return {200: {"description": description, "content": content}, **error_responses(*errors)}


def nothing_left(*errors: int) -> Responses:
    """Return the answer to a deletion, with status 204."""
    return {204: {"description": "Everything of it is deleted."}, **error_responses(*errors)}


def install_openapi(app: FastAPI) -> None:
    """Complete the application's OpenAPI document; it is made once, when first requested."""
    made_by_fastapi = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = made_by_fastapi()  # which also keeps it
            _add_models(document)
            _correct_operations(document)
            _tell_answers_apart(document)
            _complete_for_generators(document)
        return app.openapi_schema or {}

    app.openapi = openapi  # type: ignore[method-assign]


def _add_models(document: dict[str, Any]) -> None:
    _, schema = models_json_schema([(model, "validation") for model in _MODELS.values()], ref_template=_REF)
    known = document.setdefault("components", {}).setdefault("schemas", {})
    for name, definition in schema["$defs"].items():
        known.setdefault(name, definition)


def _tell_answers_apart(document: dict[str, Any]) -> None:
    """Make the answer one of three by its status, so that a client that looks at it knows whether there is a pose."""
    schemas = document["components"]["schemas"]
    _, schema = models_json_schema([(model, "serialization") for model in BY_STATUS], ref_template=_REF)
    for model in BY_STATUS:
        schemas[model.__name__] = schema["$defs"][model.__name__]
    refs = {
        schemas[model.__name__]["properties"]["status"]["const"]: _REF.format(model=model.__name__)
        for model in BY_STATUS
    }
    description = schemas[Localization.__name__]["description"]
    schemas[Localization.__name__] = {
        "description": description,
        "oneOf": [{"$ref": ref} for ref in refs.values()],
        "discriminator": {"propertyName": "status", "mapping": refs},
    }


def _complete_for_generators(document: dict[str, Any]) -> None:
    """Put nulls back into examples; say in words what is default, for generators of types take fields with a default as given; and leave
    answers open without saying so, for generated types accept every misspelt field otherwise."""
    _put_nulls_back(document)
    for schema in document["components"]["schemas"].values():
        if schema.get("additionalProperties") is True:
            del schema["additionalProperties"]
        for field in schema.get("properties", {}).values():
            default = field.pop("default", None)
            if default not in (None, [], {}) and "default" not in field.get("description", "").lower():
                field["description"] = f"{field.get('description', '')} Default: {json.dumps(default)}.".strip()


def _put_nulls_back(node: Any) -> None:
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if value == _NULL:
            node[key] = None
        elif isinstance(value, dict | list):
            _put_nulls_back(value)


def _correct_operations(document: dict[str, Any]) -> None:
    """Remove FastAPI's own 422, which this service never sends, and say that keys are optional, and which requests can be sent again."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            answer = operation.get("responses", {}).get("422", {})
            if "HTTPValidationError" in str(answer):
                del operation["responses"]["422"]
            if path in IDEMPOTENT_PATHS and method == "post":
                operation.setdefault("parameters", []).append(_IDEMPOTENCY_KEY)
            if operation.get("security"):
                operation["security"].insert(0, {})  # keys are asked for only where the operator has set some
    for name in ("HTTPValidationError", "ValidationError"):
        document["components"]["schemas"].pop(name, None)
