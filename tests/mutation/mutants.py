"""Mutants of a source file: mutmut 3 says what is changed, here each change becomes a whole file of its own.

mutmut runs its mutants inside the changed file, side by side and chosen by a trampoline; that leaves out every function with a
decorator: properties, context managers. As whole files they need no trampoline. Left out here: what stands outside of functions
(constants, types, fields with their defaults), and texts for people, which are strings with a space in them.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

import libcst as cst
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.mutation.file_mutation import Mutation, MutationVisitor, OuterFunctionProvider, deep_replace
from mutmut.mutation.mutators import mutation_operators
from mutmut.mutation.pragma_handling import IgnoredCode

_LONGEST_SHOWN = 90


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    name: file, function and number, the same as long as the file is. line: where. before, after: what was changed to what. source:
    the whole changed file.
    """

    name: str
    file: str
    line: int
    before: str
    after: str
    source: str

    def __str__(self) -> str:
        return f"{self.name}  line {self.line}: {_shown(self.before)}  →  {_shown(self.after)}"


class _Visitor(MutationVisitor):
    """Also goes into functions with decorators, but not into the decorators."""

    METADATA_DEPENDENCIES = (PositionProvider, OuterFunctionProvider)

    def _skip_node_and_children(self, node: cst.CSTNode) -> bool:
        if isinstance(node, cst.FunctionDef):
            return False
        return (isinstance(node, cst.SimpleString) and " " in node.value) or super()._skip_node_and_children(node)


class MutableFile:
    """A source file and its changes, of which each becomes a mutant when it is asked for: making one takes some 30 ms."""

    def __init__(self, file: str, source: str) -> None:
        """file: relative to the top folder; source: what it holds."""
        wrapper = MetadataWrapper(cst.parse_module(source))
        nothing: set[int] = set()
        visitor = _Visitor(mutation_operators, IgnoredCode(nothing, nothing, nothing))
        self._file, self._program = file, ast.dump(ast.parse(source))
        self._module = wrapper.visit(visitor)
        self._places = wrapper.resolve(PositionProvider)
        self._changes = list(_numbered(visitor.mutations, _qualified_names(self._module)))

    def __len__(self) -> int:
        return len(self._changes)

    def mutant(self, number: int) -> Mutant | None:
        """Return one of the mutants, None for a change that leaves the same program or none."""
        name, change = self._changes[number]
        changed = cast(cst.Module, deep_replace(self._module, change.original_node, change.mutated_node)).code
        try:
            if ast.dump(ast.parse(changed)) == self._program:
                return None
        except SyntaxError:
            return None
        before, after = (self._module.code_for_node(node) for node in (change.original_node, change.mutated_node))
        place = (
            self._places.get(change.original_node)
            or self._places[cast(cst.CSTNode, change.contained_by_top_level_function)]
        )
        return Mutant(f"{self._file}::{name}", self._file, place.start.line, before, after, changed)

    def named(self, name: str) -> Mutant | None:
        """Return the mutant of this name, None without one."""
        numbers = [k for k, (each, _) in enumerate(self._changes) if f"{self._file}::{each}" == name]
        return self.mutant(numbers[0]) if numbers else None


def _numbered(mutations: list[Mutation], names: dict[cst.CSTNode, str]) -> Iterator[tuple[str, Mutation]]:
    """Yield the changes inside of functions with their names: function and number within it."""
    counts: dict[str, int] = {}
    for mutation in mutations:
        within = mutation.contained_by_top_level_function
        if isinstance(within, cst.FunctionDef):
            name = names[within]
            counts[name] = counts.get(name, 0) + 1
            yield f"{name}#{counts[name]}", mutation


def _qualified_names(module: cst.Module) -> dict[cst.CSTNode, str]:
    names: dict[cst.CSTNode, str] = {}
    for statement in module.body:
        if isinstance(statement, cst.FunctionDef):
            names[statement] = statement.name.value
        elif isinstance(statement, cst.ClassDef):
            for member in statement.body.body:
                if isinstance(member, cst.FunctionDef):
                    names[member] = f"{statement.name.value}.{member.name.value}"
    return names


def _shown(code: str) -> str:
    words = " ".join(code.split())
    return words if len(words) <= _LONGEST_SHOWN else words[:_LONGEST_SHOWN] + "…"
