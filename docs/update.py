"""Rewrites what is generated in the documentation: `scripts/update-docs` runs this in the project's folder."""

from pathlib import Path

from docs.settings_table import with_current_table
from docs.source_tree import with_current_tree

PARTS = {"README.md": with_current_table, "docs/architecture.md": with_current_tree}


def main() -> None:
    """Rewrite the generated part of every page that has one."""
    for name, renewed in PARTS.items():
        page = Path(name)
        page.write_text(renewed(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
