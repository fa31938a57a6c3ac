"""Tables for people, made of one dictionary per row, heading to text."""

from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table


def table(rows: Sequence[Mapping[str, object]], labels: int, title: str | None = None) -> Table:
    """Return a table whose headings are those of the first of at least one row; all but the first `labels` columns align to the right."""
    made = Table(
        title=None if title is None else escape(title),
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        header_style="dim",
    )
    for number, heading in enumerate(rows[0]):
        made.add_column(heading, justify="left" if number < labels else "right", no_wrap=True)
    for row in rows:
        made.add_row(*(escape(str(row.get(heading, "–"))) for heading in rows[0]))
    return made


def print_tables(console: Console, tables: Sequence[object]) -> None:
    """Print tables and lines, each with an empty line below it."""
    for each in tables:
        console.print(each)
        console.print()
