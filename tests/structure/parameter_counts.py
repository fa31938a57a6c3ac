"""Counts the parameters of the engine: fields of its configuration, and constants of the rooms that localize."""

import ast
from dataclasses import MISSING, dataclass, fields, is_dataclass
from fnmatch import fnmatch
from typing import Any

from panoloc.core import config
from panoloc.core.config import IndexConfig, LocalizerConfig, PaperConfig
from tests.structure.rooms import localizing_rooms

_INVALID_REGIONS = "core/image/invalid_regions.py:*"
# Numbers that are no parameters, by `file:NAME`, and why.
_NO_PARAMETERS = {
    "formats of files and frames": (
        *(
            f"core/image/{name}.py:*"
            for name in ("heif_header", "conversion", "image_header", "known_camera", "reader")
        ),
        *(
            "core/map/map_codec.py:*",
            "core/map/map_index.py:INDEX_VERSION",
            "core/map/retrieval_vectors.py:RETRIEVAL_VERSION",
        ),
        *("core/geometry/pose.py:_CAMERA_AXES", "core/geometry/pose.py:_MAP_AXES"),
    ),
    "what the contract says: limits of what a caller may send, and what a radius means": (
        *("core/options.py:M[AI][XN]_[!S]*", "core/options.py:M[AI][XN]_SPACING_M", "core/options.py:*_SPAN_M"),
        *("core/options.py:FARTHEST_M", "core/options.py:QUATERNION_TOLERANCE", "core/options.py:METRES_PER_UNIT"),
        *("core/camera/camera.py:*", "core/image/photo_window.py:_MIN_*", "core/decide/hypotheses.py:_HELD"),
    ),
    "portions of work, which change no answer": (
        *("*:*_AT_ONCE", "*:RENDER_BATCH", "*:BLOCK", "*:_BLOCK", "*:_FEW", "*:_RENDERED_BYTES"),
        *("core/refine/step.py:_THREADS", "core/refine/step.py:_PLANES"),
    ),
    "mathematics and rounding": (
        *("*:_PHI", "*:_PSI", "*:_ROUNDING", "*:_INSIDE", "*:_SECTORS", "*:_AT_BOUND_DEG"),
        *("core/features/patch_descriptors.py:_LEAST", "core/features/patch_descriptors.py:_ORDER"),
        "core/camera/lens.py:_*",
    ),
    "drawn pictures": ("core/decide/pictures.py:*",),
}


def parameters_of(*roots: Any, known: frozenset[type] = frozenset()) -> list[str]:
    """Return `Class.field` for each parameter of configurations and of what they hold; no class is counted twice, nor those `known`.

    A field that holds a section, which is a class with a default for every field, stands for the fields of that class. A field that
    holds anything else is one parameter: a number, a tuple, or a class without defaults such as a distance of poses.
    """
    found: list[str] = []
    seen, left = set(known), list(roots)
    while left:
        section = left.pop(0)
        if type(section) in seen:
            continue
        seen.add(type(section))
        for field in fields(section):
            value = getattr(section, field.name)
            if _is_section(value):
                left.append(value)
            else:
                found.append(f"{type(section).__name__}.{field.name}")
    return found


def overridden_in(section: Any) -> list[str]:
    """Return `field.of.fields` for each number of a nested section that differs from the default of its class."""
    found: list[str] = []
    for field in fields(section):
        value = getattr(section, field.name)
        if not _is_section(value):
            continue
        defaults = type(value)()
        found += [
            f"{field.name}.{each.name}"
            for each in fields(value)
            if not _is_section(getattr(value, each.name)) and getattr(value, each.name) != getattr(defaults, each.name)
        ]
        found += [f"{field.name}.{name}" for name in overridden_in(value)]
    return found


def _is_section(value: Any) -> bool:
    if not is_dataclass(value) or isinstance(value, type):
        return False
    return all(field.default is not MISSING or field.default_factory is not MISSING for field in fields(value))


def constants_of(source: str) -> list[str]:
    """Return the names of module-level constants that are numbers or tuples, lists, sets and dictionaries of numbers."""
    found: list[str] = []
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets, value = [node.target], node.value
        else:
            continue
        for target in targets:
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            values = value.elts if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) else [value]
            for name, one in zip(names, values, strict=False):
                if isinstance(name, ast.Name) and name.id.isupper() and _is_number(one):
                    found.append(name.id)
    return found


def _is_number(node: ast.AST) -> bool:
    """Return whether an expression holds a number, and no text and no type of an object."""
    parts = list(ast.walk(node))
    has_text = any(isinstance(part, ast.Constant) and isinstance(part.value, str | bytes) for part in parts)
    made = [part.func for part in parts if isinstance(part, ast.Call)]
    is_made = any(isinstance(func, ast.Name) and func.id[:1].isupper() for func in made)
    numbers = [part for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, int | float)]
    is_dict_by_name = isinstance(node, ast.Dict)
    return bool(numbers) and not is_made and (is_dict_by_name or not has_text)


def reason_left_out(constant: str) -> str | None:
    """Return why a constant `file:NAME` is no parameter; None where it is one."""
    for reason, patterns in _NO_PARAMETERS.items():
        if any(fnmatch(constant, pattern) for pattern in patterns):
            return reason
    return None


@dataclass(frozen=True)
class Parameters:
    """What can be tuned, by name. overridden: numbers of nested sections that differ from their class, which are not in the total, nor are
    those of the paper. no_parameters: constants with the reason why they are none."""

    configuration: list[str]
    constants: list[str]
    invalid_regions: list[str]
    paper: list[str]
    overridden: list[str]
    no_parameters: list[str]

    @property
    def total(self) -> int:
        """Return how many parameters the engine has."""
        return len(self.configuration) + len(self.constants) + len(self.invalid_regions)


def parameters() -> Parameters:
    """Count the configuration of queries and maps, constants of `core/config.py`, and constants elsewhere in the rooms that localize."""
    shared = [value for name, value in vars(config).items() if name.isupper() and _is_section(value)]
    roots = (LocalizerConfig(), IndexConfig(), *shared)
    every = [f"{file}:{name}" for file, source in localizing_rooms().items() for name in constants_of(source)]
    regions = [name for name in every if fnmatch(name, _INVALID_REGIONS)]
    others = [(name, reason_left_out(name)) for name in every if name not in regions]
    return Parameters(
        configuration=parameters_of(*roots, known=frozenset({PaperConfig})),
        constants=[name for name, reason in others if reason is None],
        invalid_regions=regions,
        paper=parameters_of(PaperConfig()),
        overridden=[f"{type(root).__name__}.{name}" for root in roots for name in overridden_in(root)],
        no_parameters=[f"{name} ({reason})" for name, reason in others if reason is not None],
    )
