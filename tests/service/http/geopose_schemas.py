"""JSON schemas, written from the published texts.

Basic-Quaternion: OGC GeoPose 1.0 (21-056r11), all members required and of numbers, as in the building block
`ogc.geo.geopose.basic.quaternion`. Request and response: the interfaces of version 2 of the GeoPoseProtocol of OSCP; the schemas of its
published client, `@oarc/gpp-access` 0.2.1, which are TypeScript, took the same documents. Localization and capabilities: what OpenFLAME's
map server answers.
"""

from typing import Any

from jsonschema import Draft202012Validator

_NUMBER = {"type": "number"}
_UNIT = {"type": "number", "minimum": -1, "maximum": 1}


def _object(optional: tuple[str, ...] = (), **properties: Any) -> dict[str, Any]:
    required = [name for name in properties if name not in optional]
    return {"type": "object", "properties": properties, "required": required}


GEOPOSE = _object(
    position=_object(
        lat={"type": "number", "minimum": -90, "maximum": 90},
        lon={"type": "number", "minimum": -180, "maximum": 180},
        h=_NUMBER,
    ),
    quaternion=_object(x=_UNIT, y=_UNIT, z=_UNIT, w=_UNIT),
)
STRICT_GEOPOSE = {
    **GEOPOSE,
    "additionalProperties": False,
    "properties": {name: {**each, "additionalProperties": False} for name, each in GEOPOSE["properties"].items()},
}
RESPONSE = _object(
    id={"type": "string"},
    timestamp={"type": "number"},
    type={"type": "string"},
    accuracy=_object(position=_NUMBER, orientation=_NUMBER),
    geopose=STRICT_GEOPOSE,
)
OPENFLAME_ANSWER = _object(
    success={"type": "boolean"},
    pose={
        "type": ["array", "null"],
        "minItems": 4,
        "maxItems": 4,
        "items": {"type": "array", "minItems": 4, "maxItems": 4, "items": _NUMBER},
    },
    confidence={"type": "number", "minimum": 0, "maximum": 1},
)
OPENFLAME_CAPABILITIES = _object(
    commonName={"type": "string"},
    iconURL={"type": "string"},
    services={
        "type": "array",
        "minItems": 1,
        "items": _object(name={"const": "localization"}, url={"type": "string"}, types={"const": ["image"]}),
    },
)


def check(document: Any, schema: dict[str, Any]) -> None:
    """Raise where a document is not as a schema says."""
    Draft202012Validator.check_schema(schema)
    Draft202012Validator(schema).validate(document)
