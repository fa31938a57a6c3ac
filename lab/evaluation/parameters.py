"""What each parameter is worth: every number of the configuration halved and doubled, and what becomes of the answers.

Left alone are the paper's method, and what a map index is built with, which queries share.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from panoloc.core.config import IndexConfig, LocalizerConfig
from panoloc.core.errors import OptionsError
from panoloc.lab.evaluation.methods import ComparedMethod, with_value
from panoloc.lab.evaluation.rows import RIGHT, Row

_UNITS = ("_m", "_deg", "_rad", "_px")
_SAME_M, _SAME_DEG = 1e-4, 1e-2  # nearer than both, poses are the same


@dataclass(frozen=True)
class Parameter:
    """A number of the configuration, or several that are scaled together: a tuple, or a field of all sections of a tuple.

    name: the path of names that leads to it. value: as it is. half, double: methods with it halved and doubled; None where that changes
    nothing, or makes a share larger than 1.
    """

    name: str
    value: Any
    half: ComparedMethod | None
    double: ComparedMethod | None


def parameters_like(base: ComparedMethod, patterns: Sequence[str] = ()) -> list[Parameter]:
    """Return the parameters whose name fits one of the patterns, all without one. base: the method that they are changed in.

    Integers are rounded, and stay at least 1. Flags, None and texts are no parameters. Raises OptionsError where no name fits.
    """
    found = [
        Parameter(name, value, *(_varied(base, name, path, value, factor) for factor in (0.5, 2.0)))
        for name, path, value in _numbers(base.config)
        if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)
    ]
    if not found:
        raise OptionsError(f"only: expected a pattern of parameters such as judge.*, got {', '.join(patterns)}")
    return found


# A path of names; within it a tuple of sections is followed by the field that is changed in all of them.
_Path = tuple[str, ...]


def _numbers(config: LocalizerConfig) -> Iterator[tuple[str, _Path, Any]]:
    """Yield name, path and value of every number, or tuple of numbers, of a configuration."""
    of_index = {type(getattr(IndexConfig(), field.name)) for field in fields(IndexConfig)}
    for field in fields(config):
        section = getattr(config, field.name)
        if field.name != "paper" and type(section) not in of_index:
            for path, value in _numbers_in(section, (field.name,)):
                yield ".".join(path), path, value


def _numbers_in(value: Any, path: _Path) -> Iterator[tuple[_Path, Any]]:
    if is_dataclass(value):
        for field in fields(value):
            yield from _numbers_in(getattr(value, field.name), (*path, field.name))
    elif isinstance(value, tuple) and value and all(map(is_dataclass, value)):
        for field in fields(value[0]):
            together = tuple(getattr(section, field.name) for section in value)
            if any(map(_is_number, together)):
                yield (*path, field.name), together
    elif _is_number(value) or (isinstance(value, tuple) and value and all(map(_is_number, value))):
        yield path, value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _varied(base: ComparedMethod, name: str, path: _Path, value: Any, factor: float) -> ComparedMethod | None:
    """Return the method with a value times a factor; None where that is the same, or no share any more."""
    scaled = tuple(_scaled(one, factor) for one in value) if isinstance(value, tuple) else _scaled(value, factor)
    if scaled == value or (_is_share(name, value) and not _is_share(name, scaled)):
        return None
    holder: Any = base.config
    for part in path[:-1]:
        holder = getattr(holder, part)
    if isinstance(holder, tuple):
        sections = [with_value(one, path[-1:], new) for one, new in zip(holder, scaled, strict=True)]
        config = with_value(base.config, path[:-1], tuple(sections))
    else:
        config = with_value(base.config, path, scaled)
    return ComparedMethod(f"{name} x {factor:g}", base.method, config)


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, bool) or not _is_number(value):
        return value
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def _is_share(name: str, value: Any) -> bool:
    """Return whether floats without a unit are all between 0 and 1, as probabilities and shares are."""
    parts = value if isinstance(value, tuple) else (value,)
    return not name.endswith(_UNITS) and all(isinstance(one, float) and 0 <= one <= 1 for one in parts)


@dataclass(frozen=True)
class Outcome:
    """Answers to the same queries: how many are right (within 0.3 m and 10 degrees), called localized, called localized though wrong, and
    ended in an error; the median error of the poses (metres) and the median seconds of an answer.

    others: how many have another status or another pose than without the change; None of those without it.
    """

    right: int
    localized: int
    wrong: int
    failed: int
    position_error_m: float | None
    seconds: float
    others: int | None = None


@dataclass(frozen=True)
class Worth:
    """A parameter with the outcomes of half of it, of itself, and of twice itself; None where it was not varied."""

    parameter: Parameter
    half: Outcome | None
    same: Outcome
    double: Outcome | None


def worth_of(parameters: Sequence[Parameter], base: ComparedMethod, rows: Sequence[Row]) -> list[Worth]:
    """Return what rows of the method as it is and of its variants say of each parameter."""
    by_method: dict[str, list[Row]] = {}
    for row in rows:
        by_method.setdefault(row.method, []).append(row)
    as_it_is = by_method[base.name]

    def outcome(method: ComparedMethod | None) -> Outcome | None:
        """Return the outcome of a variant, where there is one."""
        return None if method is None else _outcome(by_method[method.name], as_it_is)

    return [Worth(each, outcome(each.half), _outcome(as_it_is), outcome(each.double)) for each in parameters]


def _outcome(rows: Sequence[Row], as_it_is: Sequence[Row] | None = None) -> Outcome:
    errors = [row.position_error_m for row in rows if row.position_error_m is not None]
    others = None
    if as_it_is is not None:
        before = {(row.scan, row.query): row for row in as_it_is}
        others = sum(_is_another(row, before[row.scan, row.query]) for row in rows)
    return Outcome(
        right=sum(row.within(RIGHT) and row.facts.get("place") != "other" for row in rows),
        localized=sum(row.status == "localized" for row in rows),
        wrong=sum(row.is_wrong_answer for row in rows),
        failed=sum(row.error is not None for row in rows),
        position_error_m=float(np.median(errors)) if errors else None,
        seconds=float(np.median([row.seconds for row in rows])),
        others=others,
    )


def _is_another(row: Row, before: Row) -> bool:
    """Return whether an answer has another status, or another error of its pose, than one before."""
    pairs = (
        (row.position_error_m, before.position_error_m, _SAME_M),
        (row.orientation_error_deg, before.orientation_error_deg, _SAME_DEG),
    )
    has_moved = any(
        (one is None) != (other is None) or (one is not None and other is not None and abs(one - other) > least)
        for one, other, least in pairs
    )
    return row.status != before.status or has_moved
