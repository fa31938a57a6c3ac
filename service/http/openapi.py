"""The OpenAPI document: FastAPI's own, with the forms and bodies that routes read by themselves, and the answers and
problems of each path."""

from typing import Any

from fastapi import FastAPI
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from panoloc.service.http.schemas.batches import BatchOptions
from panoloc.service.http.schemas.geopose import GeoPoseReply, GeoPoseRequest
from panoloc.service.http.schemas.maps import MapOptions, MapPatch, ScanOptions
from panoloc.service.http.schemas.operations import ProblemDocument
from panoloc.service.http.schemas.queries import LocalizeOptions
from panoloc.service.problems import error_responses

Responses = dict[int | str, dict[str, Any]]

_REF = "#/components/schemas/{model}"
# Models of forms and bodies that FastAPI does not know.
_MODELS: tuple[type[BaseModel], ...] = (
    ProblemDocument,
    MapOptions,
    ScanOptions,
    MapPatch,
    LocalizeOptions,
    BatchOptions,
    GeoPoseRequest,
    GeoPoseReply,
)


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
    return {"$ref": _REF.format(model=model.__name__)}


def multipart(
    parts: dict[str, Any], required: list[str], examples: dict[str, Any] | None = None, **constraint: Any
) -> dict[str, Any]:
    """Return the `openapi_extra` of a route that reads a multipart form. constraint: such as `oneOf`."""
    schema = {"type": "object", "properties": parts, "required": required, "additionalProperties": False, **constraint}
    encoding = {"options": {"contentType": "application/json"}} if "options" in parts else {}
    media: dict[str, Any] = {"schema": schema, "encoding": encoding}
    if examples:
        media["examples"] = examples
    return {"requestBody": {"required": True, "content": {"multipart/form-data": media}}}


def json_body(model: type[BaseModel], example: Any) -> dict[str, Any]:
    """Return the `openapi_extra` of a route that reads its JSON body itself."""
    content = {"application/json": {"schema": json_part(model), "example": example}}
    return {"requestBody": {"required": True, "content": content}}


def json_response(model: type[BaseModel], example: Any, *errors: int) -> Responses:
    """Return JSON with status 200. errors: statuses of problems."""
    return {200: {"model": model, "content": {"application/json": {"example": example}}}, **error_responses(*errors)}


def accepted_response(model: type[BaseModel], example: Any, description: str, path_of: str, *errors: int) -> Responses:
    """Return JSON with status 202. path_of: the name of what `Location` leads to."""
    headers = {
        "Location": {"description": f"Path of the {path_of}", "required": True, "schema": {"type": "string"}},
        "Retry-After": {
            "description": "Seconds to wait before the first poll",
            "required": True,
            "schema": {"type": "integer"},
        },
    }
    content = {"application/json": {"example": example}}
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
            _remove_default_errors(document)
        return app.openapi_schema or {}

    app.openapi = openapi  # type: ignore[method-assign]


def _add_models(document: dict[str, Any]) -> None:
    _, schema = models_json_schema([(model, "validation") for model in _MODELS], ref_template=_REF)
    known = document.setdefault("components", {}).setdefault("schemas", {})
    for name, definition in schema["$defs"].items():
        known.setdefault(name, definition)


def _remove_default_errors(document: dict[str, Any]) -> None:
    """Remove FastAPI's own 422, which this service never sends."""
    for operations in document["paths"].values():
        for operation in operations.values():
            answer = operation.get("responses", {}).get("422", {})
            if "HTTPValidationError" in str(answer):
                del operation["responses"]["422"]
    for name in ("HTTPValidationError", "ValidationError"):
        document["components"]["schemas"].pop(name, None)
