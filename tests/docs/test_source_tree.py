"""The tree in docs/architecture.md is that of the code, and the code keeps to its rooms."""

from pathlib import Path

import pytest

from docs.source_tree import PACKAGES, first_line, source_tree, with_current_tree
from tests.docs.documentation import ROOT

FOLDERS = sorted(init.parent for package in PACKAGES for init in (ROOT / package).rglob("__init__.py"))


def test_the_page_on_architecture_has_the_current_tree() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert page == with_current_tree(page), "run scripts/update-docs"


def test_every_line_of_the_tree_says_what_is_there() -> None:
    lines = source_tree().splitlines()[1:-1]
    assert {"core/", "  geometry/", "  localizer.py"} <= {line[:26].rstrip() for line in lines}
    assert all(len(line[26:].split()) >= 2 for line in lines), [line for line in lines if len(line[26:].split()) < 2]
    assert all(len(line) <= 180 for line in lines), [line for line in lines if len(line) > 180]


def test_a_tree_needs_its_marks() -> None:
    with pytest.raises(ValueError, match="Expected the marks"):
        with_current_tree("# A page without them")


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_a_folder_holds_at_most_fifteen_modules_and_says_what_they_are(folder: Path) -> None:
    modules = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
    assert 1 <= len(modules) <= 15 or any((path / "__init__.py").exists() for path in folder.iterdir())
    assert len(modules) <= 15
    assert first_line(folder / "__init__.py")


def test_every_python_file_lies_in_a_package() -> None:
    loose = [
        path
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if not (path.parent / "__init__.py").exists()
    ]
    assert loose == []
