"""Counts what makes the engine large: `scripts/count-engine [--list] [--no-trace]`.

Parameters, tests of the query's kind, rules that decide the status, lines, and returns to rooms that a query was in before. A *room* is a
file of `core/`. The rooms that localize are all but those of scans, exports, changes, surveys, the paper's own
method and places on Earth.
"""

import argparse
import ast
import re
from collections.abc import Iterator, Sequence

from tests.structure.parameter_counts import parameters
from tests.structure.query_walk import photo_query
from tests.structure.rooms import deciding_rooms, localizing_rooms, sources

# Of issue 38. It does not say how it counted returns; `Walk.of_rooms` finds its 117 on the tree that it speaks of.
LIMITS = {"parameters": 130, "tests of the kind": 0, "status rules": 4, "lines": 7000, "returns": 25}

# Types of queries, prepared ones and their levels included.
_KIND = re.compile(r"(Prepared)?(Panorama|Photo|Rig|Session)(?!\w*Error)\w*")
_STATUSES = frozenset({"localized", "ambiguous", "not_localized"})
MODEL = "core/decide/verdict.py:verdict"


def kind_tests(files: dict[str, str]) -> list[str]:
    """Return `file:line` of every `isinstance` and every `case` that asks what kind of query there is."""
    return [
        f"{file}:{node.lineno}"
        for file, source in files.items()
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call | ast.MatchClass)
        if (asked := _asked_types(node)) is not None
        if any(_KIND.fullmatch(_last_name(part) or "") for part in ast.walk(asked))
    ]


def _asked_types(node: ast.Call | ast.MatchClass) -> ast.expr | None:
    """Return the expression of the types that a node of the program asks for; None for one that asks for none."""
    if isinstance(node, ast.MatchClass):
        return node.cls
    return node.args[1] if _last_name(node.func) == "isinstance" and len(node.args) == 2 else None


def _last_name(node: ast.AST) -> str | None:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else None


def status_rules(files: dict[str, str]) -> list[str]:
    """Return `file:function` of the functions that set a status.

    Such a function gives the name `status`, as a variable or an argument, a literal status, or passes one to `Localization` or `Verdict`.
    A private function that sets it for several others is no rule itself: each of these is one. Rules inside a function, such as the
    margins of the model's equals, are not told apart.
    """
    functions = [
        (f"{file}:{node.name}", node)
        for file, source in files.items()
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef)
    ]
    setting = {rule for rule, node in functions if any(map(_sets_status, ast.walk(node)))}
    called = {
        rule: {_last_name(part.func) for part in ast.walk(node) if isinstance(part, ast.Call)}
        for rule, node in functions
    }
    private = {node.name for rule, node in functions if rule in setting and node.name.startswith("_")}
    shared = {name for name in private if sum(name in names for names in called.values()) > 1}
    return [rule for rule, node in functions if node.name not in shared and (rule in setting or called[rule] & shared)]


def _sets_status(node: ast.AST) -> bool:
    if isinstance(node, ast.keyword):
        return node.arg == "status" and _gives_status(node.value)
    if isinstance(node, ast.Assign):
        return any(_last_name(target) == "status" for target in node.targets) and _gives_status(node.value)
    if isinstance(node, ast.AnnAssign):
        return _last_name(node.target) == "status" and node.value is not None and _gives_status(node.value)
    if isinstance(node, ast.Call):
        return _last_name(node.func) in ("Localization", "Verdict") and any(map(_gives_status, node.args))
    return False


def _gives_status(node: ast.expr) -> bool:
    """Return whether an expression can be a literal status."""
    if isinstance(node, ast.IfExp):
        return _gives_status(node.body) or _gives_status(node.orelse)
    return isinstance(node, ast.Constant) and node.value in _STATUSES


def _lines(is_traced: bool, shows_names: bool) -> Iterator[str]:
    """Yield what is printed."""

    def count(title: str, names: Sequence[str]) -> Iterator[str]:
        yield f"  {len(names):5} {title}"
        yield from (f"        {name}" for name in names if shows_names)

    found = parameters()
    yield f"parameters: {found.total} (at most {LIMITS['parameters']})"
    yield from count("in the configuration of queries and maps", found.configuration)
    yield from count("constants of the rooms that localize", found.constants)
    yield from count("thresholds of invalid regions", found.invalid_regions)
    yield "  not in the total:"
    yield from count("of the paper's method", found.paper)
    yield from count("of sections, given again where they are used", found.overridden)
    yield from count("constants that are no parameters", found.no_parameters)
    kinds = kind_tests(sources("core/**/*.py", "service/worker/**/*.py"))
    yield f"tests of the query's kind: {len(kinds)} (at most {LIMITS['tests of the kind']})"
    yield from (f"        {place}" for place in kinds)
    rules = [rule for rule in status_rules(deciding_rooms()) if rule != MODEL]
    yield f"status rules: {len(rules)} (at most {LIMITS['status rules']}) and the model, {MODEL}"
    yield from (f"        {rule}" for rule in rules)
    rooms = localizing_rooms()
    number = sum(len(source.splitlines()) for source in rooms.values())
    yield f"lines of the {len(rooms)} rooms that localize: {number} (at most {LIMITS['lines']})"
    if is_traced:
        walk = photo_query()
        for what, steps in (
            (f"between rooms (returns at most {LIMITS['returns']})", walk.of_rooms()),
            ("between rooms, called by the pipeline alone", walk.of_pipeline()),
            ("through functions, each once", walk.of_functions()),
        ):
            yield f"a photo's query {what}: {steps.rooms} rooms, {steps.inside} steps inside, {steps.returns} returns"


def main() -> None:
    """Print all counts."""
    parser = argparse.ArgumentParser(prog="scripts/count-engine")
    parser.add_argument("--list", action="store_true", help="also print the names of what is counted")
    parser.add_argument("--no-trace", action="store_true", help="run no query")
    options = parser.parse_args()
    for line in _lines(not options.no_trace, options.list):
        print(line, flush=True)


if __name__ == "__main__":
    main()
