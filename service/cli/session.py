"""What every command shares: the two consoles, the client, how failures are shown, and the options `--url` and `--json`."""

import json
import os
import re
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.tables import alternatives_table, answer_summary, images_table
from panoloc.service.client import (
    ApiProblemError,
    ClientError,
    JsonClient,
    JsonObject,
    MapFailedError,
    UnreachableError,
)

_PIPE_WIDTH = 500
# All control characters but tabs and line ends, and the Unicode characters that reverse the direction of text.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")


def default_url() -> str:
    """Return the URL of a service that was started with the same environment."""
    host = os.environ.get("PANOLOC_HOST", "127.0.0.1")
    reachable = "127.0.0.1" if host in ("", "0.0.0.0", "::") else host
    scheme = "https" if os.environ.get("PANOLOC_TLS_CERT") else "http"
    return f"{scheme}://{reachable}:{os.environ.get('PANOLOC_PORT', '8000')}"


DEFAULT_URL = default_url()

UrlOption = Annotated[str, typer.Option("--url", envvar="PANOLOC_URL", help="URL of the service.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document per result on standard output, and nothing else.")
]


class SafeConsole(Console):
    """A console for untrusted text: control characters are shown as replacement characters, not sent to the terminal."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Return the segments of what is printed, their text without control characters."""
        for segment in super().render(renderable, options):
            if segment.control or not _CONTROL.search(segment.text):
                yield segment
            else:
                yield Segment(_CONTROL.sub("\N{REPLACEMENT CHARACTER}", segment.text), segment.style)


@dataclass
class Session:
    """State of one run of the command line.

    json_output: results go to standard output as one JSON document per line, and nothing else does.
    transport: replaces the network in tests.
    """

    transport: httpx.BaseTransport | None = None
    json_output: bool = False
    results: Console = field(default_factory=lambda: _console(stderr=False))
    messages: Console = field(default_factory=lambda: _console(stderr=True))

    def client(self, url: str) -> JsonClient:
        """Return a client of the service at `url`, with the key from PANOLOC_API_KEY when it is set."""
        return JsonClient(url, api_key=os.environ.get("PANOLOC_API_KEY"), transport=self.transport)

    @classmethod
    def of(cls, ctx: typer.Context, json_output: bool) -> "Session":
        """Return the session of a command. json_output: whether `--json` is given."""
        session: Session = ctx.obj
        session.json_output = json_output
        return session

    def show(self, document: JsonObject, text: RenderableType) -> None:
        """Print one result: the document in JSON mode, else the text or table."""
        if self.json_output:
            self.print_json(document)
        else:
            self.results.print(text, markup=False)

    def show_answer(self, answer: JsonObject, client: JsonClient, names: Sequence[str] = ()) -> None:
        """Print one localization as tables, then the links to its pictures, unbroken. names: of its images."""
        for table in (answer_summary(answer), images_table(answer, names), alternatives_table(answer)):
            if table is not None:
                self.results.print(table)
        for path in answer["artifacts"].values():
            self.results.print(client.link(path), soft_wrap=True, markup=False)

    def show_failure(self, error: ClientError, about: Sequence[str] = (), key: str = "id") -> ExitCode:
        """Show what was expected, what came and what to do; in JSON mode also as documents.

        about: the maps or images it is about. key: names them in the documents.
        """
        if self.json_output:
            for each in [{key: name} for name in about] or [{}]:
                self.print_json({**each, "error": error.as_dict()})
        show = self.messages.print
        named = f"[bold]{escape(', '.join(about))}[/]  " if about else ""
        if isinstance(error, ApiProblemError):
            show(f"{named}[bold red]{escape(error.title)}[/] [dim](HTTP {error.status})[/]")
            show(escape(str(error)))
            self._show_advice(error)
            return ExitCode.ERROR
        show(f"{named}[bold red]Error:[/] {escape(str(error))}")
        if isinstance(error, UnreachableError):
            show("Start it with [bold]panoloc serve[/], or set its URL with [bold]--url[/] or [bold]PANOLOC_URL[/].")
            return ExitCode.UNREACHABLE
        if isinstance(error, MapFailedError) and error.serving_revision is None:
            show(f"Delete the failed map with: panoloc maps delete {error.map_id}", markup=False)
        return ExitCode.ERROR

    def _show_advice(self, error: ApiProblemError) -> None:
        show = self.messages.print
        if error.status == 401:
            show(
                "Set [bold]PANOLOC_API_KEY[/] to a key of the service. "
                "Its operator makes one with [bold]panoloc keys make[/]."
            )
        if error.retry_after_s is not None:
            show(f"Try again in {error.retry_after_s:g} s.")
        if error.problem.get("request_id"):
            # The log adds nothing to errors of the caller.
            more = ": the service's log has details under this id" if error.status >= 500 else ""
            show(f"[dim]request {escape(str(error.problem['request_id']))}{more}[/]")

    def print_json(self, document: Any) -> None:
        """Print one JSON document on one line of standard output."""
        self.results.file.write(json.dumps(document, ensure_ascii=False) + "\n")
        self.results.file.flush()


def make_out_folder(folder: Path) -> None:
    """Make the folder of an option `--out`, before anything is sent. Raises OSError where it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        message = f"--out {folder}: expected a folder that can be written, got: {error.strerror}; choose another one"
        raise OSError(message) from error


def _console(*, stderr: bool) -> Console:
    """Return a console that wraps lines on a terminal. In a file or a pipe it wraps none, so that links stay whole."""
    console = SafeConsole(stderr=stderr, highlight=False, emoji=False)
    if not console.is_terminal:
        console = SafeConsole(stderr=stderr, highlight=False, emoji=False, width=_PIPE_WIDTH, soft_wrap=True)
    return console
