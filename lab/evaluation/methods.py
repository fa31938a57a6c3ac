"""The methods that can be compared, by name: both of panoloc, the paper's ablations, its predecessor, and any variant of them."""

import ast
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from typing import Any

from panoloc.core.config import LocalizerConfig, PaperConfig
from panoloc.core.decide.confidence import load_confidence_model
from panoloc.core.errors import OptionsError
from panoloc.core.options import Method


@dataclass(frozen=True)
class ComparedMethod:
    """A method under the name that it has in the tables."""

    name: str
    method: Method
    config: LocalizerConfig

    @property
    def digest(self) -> str:
        """Return 12 hex digits that change whenever the method's part of the configuration or the fitted confidence does.

        Rows of another digest are not reused.
        """
        sections = {k: v for k, v in asdict(self.config).items() if (k == "paper") == (self.method == "paper")}
        text = repr((self.method, sorted(sections.items()), load_confidence_model()))
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def _paper(**changes: Any) -> tuple[Method, LocalizerConfig]:
    return "paper", LocalizerConfig(paper=replace(PaperConfig(), **changes))


_KNOWN: Mapping[str, tuple[Method, LocalizerConfig]] = {
    "fast": ("fast", LocalizerConfig()),
    "paper": _paper(),
    # Paper, table 4: what each part is worth.
    "paper-no-histograms": _paper(initialize_by_histograms=False),
    "paper-no-2d-map": _paper(use_score_map_2d=False),
    "paper-no-3d-map": _paper(use_score_map_3d=False),
    "paper-no-color-matching": _paper(match_colors=False),
    # PICCOLO (Kim et al., ICCV 2021): starts by sampling loss, refined without maps of what changed.
    "piccolo": _paper(
        initialize_by_histograms=False, use_score_map_2d=False, use_score_map_3d=False, match_colors=False
    ),
}
METHOD_NAMES: tuple[str, ...] = tuple(_KNOWN)


def compared_method(text: str) -> ComparedMethod:
    """Return the method that a text names.

    Either one of `METHOD_NAMES`, or a variant `NAME=BASE:section.field=value,…` of one, with sections and fields of `LocalizerConfig`:
    `six=fast:search.num_candidates=6`. Raises OptionsError that says what was expected.
    """
    if text in _KNOWN:
        method, config = _KNOWN[text]
        return ComparedMethod(text, method, config)
    name, _, rest = text.partition("=")
    base, _, changes = rest.partition(":")
    if not name or base not in _KNOWN or not changes:
        raise OptionsError(
            f"method: expected one of {', '.join(METHOD_NAMES)}, or a variant NAME=BASE:section.field=value, got {text!r}"
        )
    method, config = _KNOWN[base]
    # Values can be tuples, whose commas separate nothing.
    for change in re.split(r",(?=\s*\w+(?:\.\w+)+\s*=)", changes):
        config = _changed(config, change)
    return ComparedMethod(name, method, config)


def with_value(section: Any, path: Sequence[str], value: Any) -> Any:
    """Return a section of the configuration with another value of the field that a path of names leads to."""
    name, *rest = path
    return replace(section, **{name: with_value(getattr(section, name), rest, value) if rest else value})


def _changed(config: LocalizerConfig, change: str) -> LocalizerConfig:
    """Return the configuration with one change `section.field=value` made, where fields of sections within sections have longer paths."""
    written, _, text = change.partition("=")
    path = written.strip().split(".")
    known: Any = config
    for name in path:
        is_section = is_dataclass(known) and not isinstance(known, type)
        if not is_section or name not in {field.name for field in fields(known)}:
            raise OptionsError(
                f"method: expected section.field of the configuration before '=', got {written.strip()!r}"
            )
        known = getattr(known, name)
    try:
        value = ast.literal_eval(text.strip())
    except (ValueError, SyntaxError):
        value = text.strip()
    if isinstance(known, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not type(known):
        raise OptionsError(f"method: expected {type(known).__name__} for {written.strip()}, got {text.strip()!r}")
    changed: LocalizerConfig = with_value(config, path, value)
    return changed
