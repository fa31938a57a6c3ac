"""The OpenAPI document: FastAPI's own, and the forms and bodies that routes read by themselves."""

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from panoloc.service.http.schemas import (
    BatchOptions,
    LocalizeOptions,
    MapOptions,
    MapPatch,
    ProblemDocument,
    ScanOptions,
)
from panoloc.service.http.schemas.geopose import GeoPoseReply, GeoPoseRequest

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


def picture_response(description: str) -> dict[str, Any]:
    """Return the OpenAPI response of a PNG."""
    return {"description": description, "content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}}


def accepted_headers(path_of: str) -> dict[str, Any]:
    """Return the OpenAPI headers of a 202. path_of: the resource of `Location`."""
    return {
        "Location": {"description": f"Path of the {path_of}", "required": True, "schema": {"type": "string"}},
        "Retry-After": {
            "description": "Seconds to wait before the first poll",
            "required": True,
            "schema": {"type": "integer"},
        },
    }


def install_openapi(app: FastAPI) -> None:
    """Complete the application's OpenAPI document; it is made once, when first requested."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = get_openapi(
                title=app.title,
                version=app.version,
                description=app.description,
                routes=app.routes,
                tags=app.openapi_tags,
            )
            _add_models(document)
            _remove_default_errors(document)
            app.openapi_schema = document
        return app.openapi_schema

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
