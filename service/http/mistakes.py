"""What pydantic found wrong, in the words of the service: what was expected, then what came."""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel

# By pydantic's types of errors; braces are filled from its context.
_EXPECTED = {
    "extra_forbidden": "expected no field of this name, see /docs for those that there are",
    "missing": "expected a value",
    "literal_error": "expected {expected}",
    "enum": "expected {expected}",
    "greater_than": "expected more than {gt}",
    "greater_than_equal": "expected at least {ge}",
    "less_than": "expected less than {lt}",
    "less_than_equal": "expected at most {le}",
    "finite_number": "expected a finite number",
    "too_short": "expected {min_length} or more items",
    "too_long": "expected {max_length} items or fewer",
    "string_too_short": "expected text of at least {min_length} characters",
    "string_too_long": "expected text of at most {max_length} characters",
    # The one pattern that there is, of names and tags, is for people who read expressions.
    "string_pattern_mismatch": "expected text without control characters",
}
_KINDS = {
    "int": "expected a whole number",
    "float": "expected a number",
    "bool": "expected true or false",
    "string": "expected text",
    "list": "expected a list",
    "tuple": "expected a list",
    "dict": "expected an object",
    "model": "expected an object",
    "dataclass": "expected an object",
}
_UNIT = re.compile("_(deg|rad|px|m|s|mb)$")


def sentence_of(mistake: Mapping[str, Any], model: type[BaseModel] | None = None) -> str:
    """Return what was expected where pydantic found something else; mistake: one of `ValidationError.errors()`, of `model`."""
    kind = str(mistake["type"])
    if kind == "extra_forbidden" and model is not None and (meant := _meant(mistake["loc"], model)):
        return f"expected no field of this name, perhaps you mean {meant}"
    if kind in _EXPECTED:
        return _EXPECTED[kind].format(**mistake.get("ctx", {}))
    by_kind = _KINDS.get(kind.partition("_")[0])
    if by_kind is not None:
        return by_kind
    # Ours, from a validator, which may name the field once more.
    field = str(mistake["loc"][-1]) if mistake["loc"] else ""
    return str(mistake["msg"]).removeprefix("Value error, ").removeprefix(f"{field}: ")


def _meant(location: Sequence[int | str], model: type[BaseModel]) -> str | None:
    """Return the name that is most like the last one of a location in a model, or in an object of it; units do not count, for they are what
    is left out most."""
    objects = [model]
    for part in location[:-1]:
        # An index, or which of several models was tried, leads no further down.
        fields = [each.model_fields[part] for each in objects if part in each.model_fields]
        objects = [each for field in fields for each in _models_in(field.annotation)] or objects
    wanted = str(location[-1])
    within = {
        f"{name}.{inner}": inner
        for each in objects
        for name, field in each.model_fields.items()
        for part in _models_in(field.annotation)
        for inner in part.model_fields
    }
    own = {name: name for each in objects for name in each.model_fields}
    return _most_like(wanted, own, 0.6) or _most_like(wanted, within, 0.9)


def _most_like(wanted: str, names: Mapping[str, str], least: float) -> str | None:
    """Return the key of the name that is most like the wanted one; None where none is."""
    known = {_UNIT.sub("", name): key for key, name in reversed(list(names.items()))}
    near = difflib.get_close_matches(_UNIT.sub("", wanted), known, 1, least)
    return known[near[0]] if near else None


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models that an annotation speaks of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)
