"""What callers send, held against models and limits; every mistake is named by its field, every limit by its setting."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from core.errors import PanoramaTooLargeError, ScanTooLargeError
from service.errors import InvalidOptionsError, MalformedRequestError
from service.http.mistakes import sentence_of

ModelType = TypeVar("ModelType", bound=BaseModel)

_LONGEST_VALUE = 80
_MOST_MISTAKES = 10


def parse_json(model: type[ModelType], data: bytes | None, where: str) -> ModelType:
    """Read JSON into a model; None and nothing count as `{}`. where: what it is called in messages.

    Raises MalformedRequestError for what is no JSON, InvalidOptionsError for what does not fit the model or says a thing twice.
    """
    try:
        read = model.model_validate_json(data or b"{}")
    except ValidationError as error:
        raise mistakes_error(error.errors(include_url=False), where=where, model=model) from error
    _refuse_doubles(data or b"{}")
    return read


def mistakes_error(
    mistakes: Sequence[Any], *, skip: int = 0, where: str = "", model: type[BaseModel] | None = None
) -> MalformedRequestError | InvalidOptionsError:
    """Return the error for mistakes that pydantic found; skip: parts of the location that mean nothing to callers; model: what
    they are mistakes of."""
    if any(mistake["type"] == "json_invalid" for mistake in mistakes):
        reason = next(mistake["msg"] for mistake in mistakes if mistake["type"] == "json_invalid")
        return MalformedRequestError(f"{where or 'body'}: expected JSON, but {reason}; send valid JSON")
    fields = [_field(mistake, skip, where, model) for mistake in mistakes[:_MOST_MISTAKES]]
    text = "; ".join(f"{each['field']}: {each['message']}" for each in fields)
    return InvalidOptionsError(f"{text}. Correct the fields named, see /docs", fields)


@contextmanager
def limited_by(setting: str) -> Iterator[None]:
    """Name the setting that is the limit in the message about an upload that passes it."""
    try:
        yield
    except (ScanTooLargeError, PanoramaTooLargeError) as error:
        raise type(error)(f"{error} (the limit is {setting})") from error


def _refuse_doubles(data: bytes) -> None:
    """Refuse a name that stands twice in one object: every reader takes another of the two, this one the last."""

    def check(members: list[tuple[str, object]]) -> None:
        for name, times in Counter(name for name, _ in members).items():
            if times > 1:
                shown = name[:_LONGEST_VALUE]
                message = f"expected once in its object, got {times} times; leave one"
                raise InvalidOptionsError(f"{shown}: {message}", [{"field": shown, "message": message}])

    # By now it is JSON, not deep, and its numbers were read; digits without end would be refused as integers.
    json.loads(data, object_pairs_hook=check, parse_int=str)


def _field(mistake: Any, skip: int, where: str, model: type[BaseModel] | None) -> dict[str, Any]:
    name = ".".join(str(part) for part in mistake["loc"][skip:]) or where or "body"
    message = sentence_of(mistake, model)
    value = mistake.get("input")
    got = "none" if mistake["type"] == "missing" else "null" if value is None else repr(value)
    shown = got if len(got) <= _LONGEST_VALUE else got[:_LONGEST_VALUE] + "…"
    return {"field": name, "message": message if ", got " in message else f"{message}, got {shown}"}
