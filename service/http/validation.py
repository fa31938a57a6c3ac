"""Reads what callers send into models, and says what is wrong by field: what was expected, then what came."""

import difflib
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar, get_args

from fastapi import Request
from fastapi.dependencies.models import Dependant
from pydantic import BaseModel, ValidationError

from panoloc.core.errors import OptionsError, PanoramaTooLargeError, ScanTooLargeError
from panoloc.service.errors import InvalidOptionsError, MalformedRequestError

ModelType = TypeVar("ModelType", bound=BaseModel)

_LONGEST_VALUE = 80
_MOST_MESSAGES = 10
# By pydantic's types of errors; braces are filled from its context.
_EXPECTED = {
    "missing": "expected a value",
    "literal_error": "expected {expected}",
    "enum": "expected {expected}",
    "greater_than": "expected more than {gt}",
    "greater_than_equal": "expected at least {ge}",
    "less_than": "expected less than {lt}",
    "less_than_equal": "expected at most {le}",
    "finite_number": "expected a finite number",
    "none_required": "expected null, for this request does not take it",
    "too_short": "expected {min_length} or more items",
    "too_long": "expected {max_length} items or fewer",
    "string_too_short": "expected text of at least {min_length} characters",
    "string_too_long": "expected text of at most {max_length} characters",
    # The only pattern, of names and tags, is for people who read expressions.
    "string_pattern_mismatch": "expected text without control characters",
}
# By the beginnings of pydantic's types of errors.
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


def parse_json(model: type[ModelType], data: bytes | None, where: str) -> ModelType:
    """Read JSON into a model; None and nothing count as `{}`. where: what it is called in messages.

    Raises MalformedRequestError for what is no JSON, InvalidOptionsError for what does not fit the model or says a
    thing twice.
    """
    try:
        read = model.model_validate_json(data or b"{}")
    except ValidationError as error:
        raise validation_error(error.errors(include_url=False), where=where, model=model) from error
    _refuse_doubles(data or b"{}")
    return read


def validation_error(
    found: Sequence[Any], *, skip: int = 0, where: str = "", model: type[BaseModel] | None = None
) -> MalformedRequestError | InvalidOptionsError:
    """Return the error for what pydantic found in a model; skip: parts of the location that mean nothing to callers."""
    if any(each["type"] == "json_invalid" for each in found):
        reason = next(each["msg"] for each in found if each["type"] == "json_invalid")
        return MalformedRequestError(f"{where or 'body'}: expected JSON, but {reason}; send valid JSON")
    fields = [_field(each, skip, where, model) for each in found[:_MOST_MESSAGES]]
    text = "; ".join(f"{each['field']}: {each['message']}" for each in fields)
    return InvalidOptionsError(f"{text}. Correct the named fields (see /docs)", fields)


@contextmanager
def limited_by(setting: str) -> Iterator[None]:
    """Name the setting that is the limit in the message about an upload that passes it."""
    try:
        yield
    except (ScanTooLargeError, PanoramaTooLargeError) as error:
        raise type(error)(f"{error} (the limit is {setting})") from error


@contextmanager
def named_field() -> Iterator[None]:
    """Raise InvalidOptionsError of the field that the message of an OptionsError begins with."""
    try:
        yield
    except OptionsError as error:
        field, _, words = str(error).partition(": ")
        raise InvalidOptionsError.of(field, words) from error


def check_query_parameters(request: Request) -> None:
    """Refuse query parameters that the route of a request does not know, so that a misspelt one is not ignored.

    Raises InvalidOptionsError.
    """
    known = list(_query_parameters(request.scope["route"].dependant))
    for name in request.query_params:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            advice = f"perhaps you mean {near[0]}" if near else f"the path takes {', '.join(known) or 'none'}"
            raise InvalidOptionsError.of(name[:_LONGEST_VALUE], f"expected no query parameter of this name, {advice}")


def _query_parameters(dependant: Dependant) -> Iterator[str]:
    yield from (str(each.alias) for each in dependant.query_params)
    for each in dependant.dependencies:
        yield from _query_parameters(each)


def _refuse_doubles(data: bytes) -> None:
    """Refuse a name that is twice in one object: some readers take the first value, others, like this one, the last."""

    def check(members: list[tuple[str, object]]) -> None:
        for name, times in Counter(name for name, _ in members).items():
            if times > 1:
                message = f"expected once in its object, got {times} times; remove the others"
                raise InvalidOptionsError.of(name[:_LONGEST_VALUE], message)

    # pydantic has read it: it is JSON and not deep. Long numbers, which the model refuses, are left as text.
    json.loads(data, object_pairs_hook=check, parse_int=str)


def _field(found: Mapping[str, Any], skip: int, where: str, model: type[BaseModel] | None) -> dict[str, Any]:
    name = ".".join(str(part) for part in found["loc"][skip:]) or where or "body"
    message = _expected(found, model)
    value = found.get("input")
    got = repr(value) if isinstance(value, str) else json.dumps(value, default=str)
    if found["type"] == "missing":
        got = "none"
    display = got if len(got) <= _LONGEST_VALUE else got[:_LONGEST_VALUE] + "…"
    return {"field": name, "message": message if ", got " in message else f"{message}, got {display}"}


def _expected(found: Mapping[str, Any], model: type[BaseModel] | None) -> str:
    kind = str(found["type"])
    if kind == "extra_forbidden":
        meant = None if model is None else _meant(found["loc"], model)
        advice = f"perhaps you mean {meant}" if meant else "see /docs for the fields"
        return f"expected no field of this name, {advice}"
    if kind in _EXPECTED:
        return _EXPECTED[kind].format(**found.get("ctx", {}))
    if by_kind := _KINDS.get(kind.partition("_")[0]):
        return by_kind
    # From a validator of ours, which may name the field once more.
    field = str(found["loc"][-1]) if found["loc"] else ""
    return str(found["msg"]).removeprefix("Value error, ").removeprefix(f"{field}: ")


def _meant(location: Sequence[int | str], model: type[BaseModel]) -> str | None:
    """Return the field that is most like the unknown one at a location: of the same object, or with its path of an
    object within."""
    at, unknown = [str(part) for part in location[:-1] if isinstance(part, str)], str(location[-1])
    paths = [path[len(at) :] for path in _field_paths(model) if list(path[: len(at)]) == at]
    near = _most_like(unknown, [path for path in paths if len(path) == 1], 0.65)
    return near or _most_like(unknown, [path for path in paths if len(path) == 2], 0.9)


def _most_like(unknown: str, paths: Sequence[tuple[str, ...]], least: float) -> str | None:
    """Return the path whose last name is most like the unknown one. Units do not count, because callers often leave
    them out."""
    names = {_UNIT.sub("", path[-1]): ".".join(path) for path in reversed(paths)}
    near = difflib.get_close_matches(_UNIT.sub("", unknown), names, 1, least)
    return names[near[0]] if near else None


def _field_paths(model: type[BaseModel]) -> Iterator[tuple[str, ...]]:
    """Yield the names that lead to each field of a model and of the models within."""
    for name, field in model.model_fields.items():
        yield (name,)
        for inner in _models_in(field.annotation):
            yield from ((name, *path) for path in _field_paths(inner))


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)
