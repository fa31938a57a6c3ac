"""What every command shares: the two consoles, the way to the service, how failures are shown, and the options `--url` and `--json`."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import httpx
import typer
from rich.console import Console
from rich.markup import escape

from service.cli.exit_codes import ExitCode
from service.cli.safe_console import SafeConsole
from service.cli.tables import alternatives_table, answer_summary, images_table, picture_links
from service.client import ApiProblemError, ClientError, JsonObject, MapFailedError, PanolocClient, UnreachableError

_PIPE_WIDTH = 500


def default_url() -> str:
    """Return where a service started with the same environment listens."""
    host = os.environ.get("PANOLOC_HOST", "127.0.0.1")
    reachable = "127.0.0.1" if host in ("", "0.0.0.0", "::") else host
    return f"http://{reachable}:{os.environ.get('PANOLOC_PORT', '8000')}"


DEFAULT_URL = default_url()

UrlOption = Annotated[str, typer.Option("--url", envvar="PANOLOC_URL", help="Where the service listens.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document per result on standard output, and nothing else there.")
]


@dataclass
class Session:
    """State of one run of the command line.

    json_output: results go to standard output as one JSON document per line, and nothing else does.
    transport: replaces the network, for tests.
    """

    transport: httpx.BaseTransport | None = None
    json_output: bool = False
    results: Console = field(default_factory=lambda: _console(stderr=False))
    messages: Console = field(default_factory=lambda: _console(stderr=True))

    def client(self, url: str) -> PanolocClient:
        """Return a client of the service at `url`, with the key from PANOLOC_API_KEY when it is set."""
        return PanolocClient(url, api_key=os.environ.get("PANOLOC_API_KEY"), transport=self.transport)

    def show_answer(self, answer: JsonObject, client: PanolocClient, names: Sequence[str] = ()) -> None:
        """Print one localization as tables, and the links of its pictures so that no terminal breaks them. names: of its images."""
        self.results.print(answer_summary(answer))
        images = images_table(answer, names)
        if images is not None:
            self.results.print(images)
        others = alternatives_table(answer)
        if others is not None:
            self.results.print(others)
        for link in picture_links(answer, client.link):
            self.results.print(link, soft_wrap=True, markup=False)

    def show_failure(self, error: ClientError, ids: Sequence[str] = ()) -> ExitCode:
        """Show what was expected, what came and what to do; in JSON mode also as a document. ids: of several, those that it is about."""
        if self.json_output:
            for about in [{"id": each} for each in ids] or [{}]:
                self.print_json({**about, "error": error.as_dict()})
        show = self.messages.print
        named = f"[bold]{escape(', '.join(ids))}[/]  " if ids else ""
        if isinstance(error, UnreachableError):
            show(f"{named}[bold red]Error:[/] {escape(str(error))}")
            show(
                "Start it with [bold]panoloc serve[/], or say where it runs with [bold]--url[/] or [bold]PANOLOC_URL[/]."
            )
            return ExitCode.UNREACHABLE
        if not isinstance(error, ApiProblemError):
            show(f"{named}[bold red]Error:[/] {escape(str(error))}")
            if isinstance(error, MapFailedError) and error.serving_revision is None:
                show(f"The failed map stays until you delete it: panoloc maps delete {error.map_id}", markup=False)
            return ExitCode.ERROR
        show(f"{named}[bold red]{escape(error.title)}[/] [dim](HTTP {error.status})[/]")
        show(escape(str(error)))
        if error.status == 401:
            show(
                "Set [bold]PANOLOC_API_KEY[/] to a key of the service; its operator makes one with [bold]panoloc keys make[/]."
            )
        if error.retry_after_s is not None:
            show(f"Try again in {error.retry_after_s:g} s.")
        if error.problem.get("request_id"):
            # Of other faults the log knows no more than was said.
            more = ": the service's log says more under this id" if error.status >= 500 else ""
            show(f"[dim]request {escape(str(error.problem['request_id']))}{more}[/]")
        return ExitCode.ERROR

    def print_json(self, document: Any) -> None:
        """Print one JSON document on one line of standard output."""
        self.results.file.write(json.dumps(document, ensure_ascii=False) + "\n")
        self.results.file.flush()


def _console(*, stderr: bool) -> Console:
    """Return a console that breaks lines for a terminal, and never in a file or a pipe, where links must stay whole."""
    console = SafeConsole(stderr=stderr, highlight=False, emoji=False)
    return (
        console
        if console.is_terminal
        else SafeConsole(stderr=stderr, highlight=False, emoji=False, width=_PIPE_WIDTH, soft_wrap=True)
    )
