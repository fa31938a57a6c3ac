"""What pydantic found wrong, in the words of the service: what was expected, then what came."""

from collections.abc import Mapping
from typing import Any

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
    "too_short": "expected at least {min_length} items",
    "too_long": "expected at most {max_length} items",
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


def sentence_of(mistake: Mapping[str, Any]) -> str:
    """Return what was expected where pydantic found something else; mistake: one of `ValidationError.errors()`."""
    kind = str(mistake["type"])
    if kind in _EXPECTED:
        return _EXPECTED[kind].format(**mistake.get("ctx", {}))
    by_kind = _KINDS.get(kind.partition("_")[0])
    if by_kind is not None:
        return by_kind
    # Ours, from a validator, which may name the field once more.
    field = str(mistake["loc"][-1]) if mistake["loc"] else ""
    return str(mistake["msg"]).removeprefix("Value error, ").removeprefix(f"{field}: ")
