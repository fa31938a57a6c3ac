"""What the commands of the lab show: a bar of progress, errors, and tables made of one dictionary per row, heading to text."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from panoloc.core.errors import CoreError
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import Session


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


@contextmanager
def progress(console: Console, total: int) -> Iterator[tuple[Callable[[str], None], Callable[[], None]]]:
    """Show a bar of `total` steps on a terminal; yield what shows the step under way, and what counts it."""
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    shown = TextColumn("{task.description}")
    with Progress(shown, *columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda text: bar.update(task, description=escape(text)), lambda: bar.advance(task)


@contextmanager
def core_errors_shown(session: Session) -> Iterator[None]:
    """End the command with one message where the algorithm or a source raises an error."""
    try:
        yield
    except CoreError as error:
        if session.json_output:
            session.print_json({"error": {"type": type(error).__name__, "message": str(error)}})
        session.messages.print(f"[bold red]Error:[/] {escape(str(error))}")
        raise typer.Exit(ExitCode.ERROR) from error
