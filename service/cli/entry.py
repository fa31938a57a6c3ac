"""Assembles the commands, and turns every expected failure into a message and an exit code."""

import importlib.metadata
from typing import Annotated, Any

import httpx
import typer
from rich.markup import escape
from typer.core import TyperGroup

from panoloc.service.cli import certificate, changes, keys, localize, maps, register, serve
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.placing import export, place
from panoloc.service.cli.session import Session
from panoloc.service.client import ClientError
from panoloc.service.keys.key_file import KeyFileError


def _exit_with(code: int | None, **_: Any) -> None:
    """Make what a command returns the exit code of the process."""
    raise typer.Exit(code or ExitCode.OK)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"panoloc {importlib.metadata.version('panoloc')}")
        raise typer.Exit


class _Commands(TyperGroup):
    """The commands, with messages about their options in Typer's words alone."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")  # of pydantic, with which Typer checks values
            raise


app = typer.Typer(
    name="panoloc",
    cls=_Commands,
    help="Find where a 360° photo was taken inside a scanned place.",
    no_args_is_help=True,
    result_callback=_exit_with,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 done or localized, 1 error, 2 wrong usage, 3 not localized, 4 ambiguous, 5 no service.",
)


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Find where a 360° photo was taken inside a scanned place."""


app.command()(serve.serve)
app.command()(serve.workers)
app.command()(register.register)
app.command()(localize.localize)
app.command()(place.place)
app.command()(export.export)
app.command()(changes.changes)
app.command()(certificate.certificate)
app.add_typer(maps.app, name="maps")
app.add_typer(keys.app, name="keys")
# Commands of other packages, such as the lab: each entry point adds its own.
for package in importlib.metadata.entry_points(group="panoloc.commands"):
    package.load()(app)


def run(arguments: list[str], transport: httpx.BaseTransport | None = None) -> int:
    """Run one command and return its exit code; `transport` replaces the network in tests."""
    session = Session(transport=transport)
    try:
        app(arguments, obj=session)
    except SystemExit as end:
        # Typer has shown wrong usage by now; Ctrl-C arrives as 130.
        return int(end.code or ExitCode.OK)
    except ClientError as error:
        return session.show_failure(error)
    except (OSError, KeyFileError) as error:
        session.messages.print(f"[bold red]Error:[/] {escape(str(error))}")
        return ExitCode.ERROR
    return ExitCode.OK
