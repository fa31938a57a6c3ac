"""Whatever has a name without an underscore says what it is; functions within functions may leave that to the outer one."""

import ast
from collections.abc import Iterator

import pytest

from tests.docs.documentation import ROOT


def definitions(node: ast.Module | ast.ClassDef) -> Iterator[ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield the classes, functions and methods with a public name."""
    for child in node.body:
        if isinstance(child, ast.ClassDef):
            yield from definitions(child)
        if isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and not child.name.startswith("_"):
            yield child


@pytest.mark.slow
@pytest.mark.parametrize("package", ["core", "lab", "service"])
def test_every_public_name_has_a_docstring(package: str) -> None:
    missing = []
    for path in sorted((ROOT / package).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        undocumented = [each for each in definitions(tree) if not ast.get_docstring(each)]
        missing += [f"{path.relative_to(ROOT)}:{each.lineno} {each.name}" for each in undocumented]
        if not ast.get_docstring(tree):
            missing.append(str(path.relative_to(ROOT)))
    assert missing == []
