"""Writes the TypeScript types of what the API sends, `src/api/schema.ts`, from the pydantic models that send it.

`python -m panoloc.service.console.api_types` in the project's folder rewrites the file; a test compares it with the
models.
"""

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from panoloc.service.answer import Localization
from panoloc.service.http.schemas.batches import Batch, BatchOverview
from panoloc.service.http.schemas.maps import Georeference, Map, MapChanges, MapLink
from panoloc.service.http.schemas.operations import Health
from panoloc.service.http.schemas.queries import PendingLocalization

FILE = Path(__file__).parent / "src" / "api" / "schema.ts"

_HEAD = "/** Generated from the models of the HTTP API by `python -m panoloc.service.console.api_types`: change those instead. */\n"
_MODELS: tuple[type[BaseModel], ...] = (
    Localization,
    PendingLocalization,
    Map,
    Georeference,
    Batch,
    BatchOverview,
    MapChanges,
    MapLink,
    Health,
)
_PRIMITIVES = {"string": "string", "number": "number", "integer": "number", "boolean": "boolean", "null": "null"}


def typescript() -> str:
    """Return the file: an interface for each model that the console reads, and for each model within those."""
    _, schema = models_json_schema([(model, "serialization") for model in _MODELS], ref_template="{model}")
    return "\n".join([_HEAD, *(_interface(name, model) for name, model in schema["$defs"].items())])


def _interface(name: str, model: dict[str, Any]) -> str:
    required = model.get("required", ())
    fields = (f"  {field}{'' if field in required else '?'}: {_type(of)};" for field, of in model["properties"].items())
    return "\n".join([f"export interface {name} {{", *fields, "}\n"])


def _type(schema: dict[str, Any]) -> str:
    """Return the type of a JSON schema of pydantic. Raises KeyError for a kind that no model uses so far."""
    if "$ref" in schema:
        return str(schema["$ref"])
    if "const" in schema or "enum" in schema:
        return " | ".join(map(json.dumps, schema.get("enum", [schema.get("const")])))
    if "anyOf" in schema:
        return " | ".join(map(_type, schema["anyOf"]))
    if schema.get("type") == "array":
        item, length = _type(schema["items"]), schema.get("maxItems")
        if length and length == schema.get("minItems") and item == "number":
            return f"[{', '.join([item] * length)}]"
        return f"{item}[]" if item.isidentifier() else f"Array<{item}>"
    if schema.get("type") == "object":
        values = schema["additionalProperties"]
        return f"Record<string, {'unknown' if values is True else _type(values)}>"
    return _PRIMITIVES[schema["type"]]


if __name__ == "__main__":
    FILE.write_text(typescript(), encoding="utf-8")
