"""Progress on standard error: a bar on a terminal; elsewhere, for long work, a line every half minute."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from panoloc.service.client import JsonObject, UploadProgress

LINE_S = 30.0


@contextmanager
def show_upload(console: Console, name: str) -> Iterator[UploadProgress]:
    """Show a bar of the bytes sent while the block runs; yields the function to report them to."""
    columns = TextColumn("[bold]uploading[/] {task.fields[name]}"), BarColumn(), DownloadColumn(), TransferSpeedColumn()
    with _progress(console, *columns) as bar:
        task = bar.add_task("upload", total=None, name=name)
        yield lambda sent, size: bar.update(task, completed=sent, total=size)


@contextmanager
def show_registration(console: Console) -> Iterator[Callable[[JsonObject], None]]:
    """Show status, stage and progress of a registration; yields the function to report the map to."""
    text = TextColumn("[bold]{task.fields[status]}[/] {task.fields[stage]}")
    with _progress(console, SpinnerColumn(), text, BarColumn(), TimeElapsedColumn()) as bar:
        task, log = bar.add_task("registration", total=1.0, status="queued", stage=""), _lines(console)

        def update(place: JsonObject) -> None:
            status, stage = place["status"], place.get("stage") or ""
            bar.update(task, completed=place.get("progress") or 0.0, status=status, stage=stage)
            log(f"{place['id']}: {status} {stage}")

        yield update


@contextmanager
def show_counts(console: Console, text: str, total: int) -> Iterator[Callable[[Mapping[str, int]], None]]:
    """Show how many of `total` are done, by status; yields the function to report the counts to."""
    columns = (
        *(TextColumn("[bold]{task.description}[/]"), BarColumn(), MofNCompleteColumn()),
        *(TextColumn("{task.fields[counts]}"), TimeElapsedColumn(), TimeRemainingColumn()),
    )
    with _progress(console, *columns) as bar:
        task, log = bar.add_task(text, total=total, counts=""), _lines(console)

        def update(counts: Mapping[str, int]) -> None:
            done, by_status = sum(counts.values()), counts_text(counts)
            bar.update(task, completed=done, counts=by_status)
            log(f"{text}: {done} of {total}: {by_status}")

        yield update


@contextmanager
def show_waiting(console: Console, text: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner, a text and the seconds while the block runs; yields the function that changes the text."""
    with _progress(console, SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()) as bar:
        task = bar.add_task(text, total=None)
        yield lambda changed: bar.update(task, description=changed)


def _lines(console: Console) -> Callable[[str], None]:
    """Return what prints a line where no bar is seen, once in `LINE_S`: in a log, hours without one look like a hang."""
    last_s = time.monotonic()

    def log(line: str) -> None:
        nonlocal last_s
        if not console.is_terminal and time.monotonic() - last_s >= LINE_S:
            last_s = time.monotonic()
            console.print(line.rstrip(), markup=False, highlight=False)

    return log


def counts_text(counts: Mapping[str, int]) -> str:
    """Return counts by status in words: `1 failed, 2 localized`."""
    return ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in sorted(counts.items()))


def _progress(console: Console, *columns: ProgressColumn) -> Progress:
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
