"""Writes the source tree, two levels with one line each, from the first lines of the docstrings.

`scripts/update-docs` runs this; a test holds docs/architecture.md against it.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

from docs.generated_part import with_part

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("core", "lab", "service")
_COLUMN = 26


def source_tree() -> str:
    """Return the packages with their rooms and modules as a code block."""
    lines = [line for package in PACKAGES for line in _package(ROOT / package)]
    return "```\n" + "\n".join(lines) + "\n```\n"


def with_current_tree(page: str) -> str:
    """Return the page with its tree replaced by the current one; raises ValueError without its marks."""
    return with_part(page, "tree", source_tree())


def first_line(module: Path) -> str:
    """Return the first sentence of a module's docstring, without its full stop."""
    text = ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split()).split(". ")[0].rstrip(".")


def _package(folder: Path) -> Iterator[str]:
    yield _line("", folder.name + "/", first_line(folder / "__init__.py"))
    rooms = sorted(path for path in folder.iterdir() if (path / "__init__.py").exists())
    modules = sorted(path for path in folder.glob("*.py") if path.name != "__init__.py")
    for room in rooms:
        yield _line("  ", room.name + "/", first_line(room / "__init__.py"))
    for module in modules:
        yield _line("  ", module.name, first_line(module))


def _line(indent: str, name: str, text: str) -> str:
    return f"{indent}{name}".ljust(_COLUMN) + text
