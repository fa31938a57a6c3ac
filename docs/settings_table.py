"""Writes the settings as a Markdown table, from `service.settings` itself.

`scripts/update-docs` runs this; a test holds the README against it.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from service.settings import Settings

BEGIN = "<!-- settings: begin (scripts/update-docs writes this table) -->\n"
END = "<!-- settings: end -->"
# From here on digits are grouped; pydantic reads the groups.
_LONG_NUMBER = 10_000


def settings_table() -> str:
    """Return one Markdown row per setting: environment variable, default, meaning."""
    prefix = str(Settings.model_config.get("env_prefix", "")).upper()
    rows = ["| variable | default | meaning |", "|---|---|---|"]
    for name, field in Settings.model_fields.items():
        variables = " or ".join(f"`{variable}`" for variable in _variables(prefix, name, field))
        rows.append(f"| {variables} | {_default(field)} | {_meaning(field)} |")
    return "\n".join(rows) + "\n"


def with_current_table(page: str) -> str:
    """Return the page with the table between its two marks replaced; raises ValueError without the marks."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(
            f"Expected the marks {BEGIN.strip()!r} and {END!r} in the page; put them where the table belongs."
        )
    return f"{before}{BEGIN}\n{settings_table()}\n{END}{after}"


def _variables(prefix: str, name: str, field: FieldInfo) -> Iterator[str]:
    alias = field.validation_alias
    if alias is None:
        yield f"{prefix}{name.upper()}"
    else:
        for choice in getattr(alias, "choices", [alias]):
            yield str(choice).upper()


def _default(field: FieldInfo) -> str:
    value: Any = field.get_default(call_default_factory=True, validated_data={})
    if value is PydanticUndefined:
        return "required"
    if value is None:
        return "not set"
    if value == "":
        return "empty"
    if isinstance(value, bool):
        return f"`{value}`".lower()
    return f"`{value:_}`" if isinstance(value, int) and value >= _LONG_NUMBER else f"`{value}`"


def _meaning(field: FieldInfo) -> str:
    choices = [repr(choice).strip("'") for choice in get_args(field.annotation) if isinstance(choice, str)]
    text = " ".join((field.description or "").split()).replace("|", "\\|")
    return f"{text} One of {', '.join(choices)}." if choices and choices[0] not in text else text


def main() -> None:
    """Rewrite the table in the README of the current folder."""
    readme = Path("README.md")
    readme.write_text(with_current_table(readme.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
