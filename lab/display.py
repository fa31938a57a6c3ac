"""What the commands of the lab show: a bar of progress, errors, and tables made of one dictionary per row, heading to text."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from json import dumps
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from panoloc.core.errors import CoreError
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import Session

_TEXT_WIDTH = 240


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


def show_report(
    session: Session, out: Path, name: str, document: Any, tables: Sequence[object], shown: Any = None
) -> None:
    """Write a report as `NAME.json` and `NAME.txt` into a folder, and show its tables, or with --json `shown`: the document where it is
    None."""
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.json").write_text(dumps(document, indent=1) + "\n", encoding="utf-8")
    with (out / f"{name}.txt").open("w", encoding="utf-8") as stream:
        print_tables(Console(file=stream, width=_TEXT_WIDTH), tables)
    if session.json_output:
        session.print_json(document if shown is None else shown)
    else:
        print_tables(session.results, tables)


@contextmanager
def progress(console: Console, total: int) -> Iterator[tuple[Callable[[str], None], Callable[[], None]]]:
    """Show a bar of `total` steps on a terminal; yield what shows the step under way, and what counts it."""
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    shown = TextColumn("{task.description}")
    with Progress(shown, *columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda text: bar.update(task, description=escape(text)), lambda: bar.advance(task)


@contextmanager
def session_of(ctx: typer.Context, json: bool) -> Iterator[Session]:
    """Yield the session of a command; end the command with one message where the algorithm or a source raises an error."""
    session = Session.of(ctx, json)
    try:
        yield session
    except CoreError as error:
        if session.json_output:
            session.print_json({"error": {"type": type(error).__name__, "message": str(error)}})
        session.messages.print(f"[bold red]Error:[/] {escape(str(error))}")
        raise typer.Exit(ExitCode.ERROR) from error
