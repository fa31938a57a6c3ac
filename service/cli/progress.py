"""Progress on standard error: bars where a person can see them, and of what takes long a line now and then where not."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from service.client import JsonObject, UploadProgress

LINE_S = 30.0


@contextmanager
def show_upload(console: Console, name: str) -> Iterator[UploadProgress]:
    """Show a bar of bytes sent while the block runs; yields the function to report them to."""
    columns = (
        TextColumn("[bold]uploading[/] {task.fields[name]}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("upload", total=None, name=name)
        yield lambda sent, size: bar.update(task, completed=sent, total=size)


@contextmanager
def show_registration(console: Console) -> Iterator[Callable[[JsonObject], None]]:
    """Show status, stage and progress of a registration; yields the function to report the map to."""
    columns = (
        SpinnerColumn(),
        TextColumn("[bold]{task.fields[status]}[/] {task.fields[stage]}"),
        BarColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("registration", total=1.0, status="queued", stage="")

        def update(place: JsonObject) -> None:
            bar.update(
                task, completed=place.get("progress") or 0.0, status=place["status"], stage=place.get("stage") or ""
            )

        yield update


@contextmanager
def show_counts(console: Console, text: str, total: int) -> Iterator[Callable[[Mapping[str, int]], None]]:
    """Show how many of `total` have ended, and how; yields the function to report the counts by status to."""
    columns = (
        TextColumn("[bold]{task.description}[/]"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[counts]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    told_s = time.monotonic()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(text, total=total, counts="")

        def update(counts: Mapping[str, int]) -> None:
            nonlocal told_s
            ended = sum(counts.values())
            told = ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in sorted(counts.items()))
            bar.update(task, completed=ended, counts=told)
            # A log gets a line now and then: hours without a word look like a hang.
            if not console.is_terminal and time.monotonic() - told_s >= LINE_S:
                told_s = time.monotonic()
                console.print(f"{text}: {ended} of {total}: {told}", markup=False, highlight=False)

        yield update


@contextmanager
def show_waiting(console: Console, text: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner with a text and the seconds while the block runs; yields the function that changes the text."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(text, total=None)
        yield lambda changed: bar.update(task, description=changed)
