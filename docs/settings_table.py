"""Writes the settings as a Markdown table, from `service.settings` itself.

`scripts/update-docs` runs this; a test holds the README against it.
"""

from collections.abc import Iterator
from typing import Any, get_args

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from docs.generated_part import with_part
from service.settings import Settings

# From here on digits are grouped; pydantic reads the groups.
_LONG_NUMBER = 10_000


def settings_table() -> str:
    """Return one Markdown row per setting: environment variable, default, meaning."""
    prefix = str(Settings.model_config.get("env_prefix", "")).upper()
    rows = ["| variable | default | meaning |", "|---|---|---|"]
    # Those of its bases come first otherwise.
    own = [name for name in Settings.model_fields if name in Settings.__annotations__]
    for name in dict.fromkeys([*own, *Settings.model_fields]):
        field = Settings.model_fields[name]
        variables = " or ".join(f"`{variable}`" for variable in _variables(prefix, name, field))
        rows.append(f"| {variables} | {_default(field)} | {_meaning(field)} |")
    return "\n".join(rows) + "\n"


def with_current_table(page: str) -> str:
    """Return the page with its table replaced by the current one; raises ValueError without its marks."""
    return with_part(page, "settings", settings_table())


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
