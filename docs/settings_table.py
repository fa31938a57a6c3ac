"""Writes the settings as a table into docs/operations.md, from `panoloc.service.settings` itself: `scripts/update-docs`
runs this.

A test holds the page against it.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from pydantic.fields import FieldInfo

from panoloc.service.settings import Settings

PAGE = Path(__file__).with_name("operations.md")
_BEGIN = "<!-- settings: begin (scripts/update-docs writes this part) -->\n"
_END = "<!-- settings: end -->"
# From here on digits are grouped; pydantic reads the groups.
_LONG_NUMBER = 10_000


def settings_table() -> str:
    """Return one Markdown row per setting: environment variable, default, meaning."""
    rows = ["| variable | default | meaning |", "|---|---|---|"]
    # Fields of base classes come last.
    own = [name for name in Settings.model_fields if name in Settings.__annotations__]
    for name in dict.fromkeys([*own, *Settings.model_fields]):
        field = Settings.model_fields[name]
        variables = " or ".join(f"`{variable}`" for variable in _variables(name, field))
        rows.append(f"| {variables} | {_default(field)} | {_meaning(field)} |")
    return "\n".join(rows) + "\n"


def with_current_table(page: str) -> str:
    """Return the page with its table replaced by the current one; raises ValueError without the marks of the table."""
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not begin or not end:
        raise ValueError(f"Expected the marks {_BEGIN.strip()!r} and {_END!r} around the table; put them back.")
    return f"{before}{begin}\n{settings_table()}\n{end}{after}"


def _variables(name: str, field: FieldInfo) -> Iterator[str]:
    alias = field.validation_alias
    for choice in getattr(alias, "choices", [alias or f"panoloc_{name}"]):
        yield str(choice).upper()


def _default(field: FieldInfo) -> str:
    value: Any = field.get_default(call_default_factory=True, validated_data={})
    if value is None or value == "":
        return "not set"
    if isinstance(value, bool):
        return f"`{value}`".lower()
    return f"`{value:_}`" if isinstance(value, int) and value >= _LONG_NUMBER else f"`{value}`"


def _meaning(field: FieldInfo) -> str:
    choices = [choice for choice in get_args(field.annotation) if isinstance(choice, str)]
    text = " ".join((field.description or "").split()).replace("|", "\\|")
    return f"{text} One of {', '.join(choices)}." if choices else text


if __name__ == "__main__":
    PAGE.write_text(with_current_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
