"""`panoloc serve`: start the service in the foreground."""

import difflib
import importlib.util
import os
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import Session
from panoloc.service.host.address import why_not_free

# Variables that other commands, the scripts or the container image read.
_OF_OTHER_COMMANDS = {
    f"PANOLOC_{name}" for name in ("URL", "API_KEY", "EVAL_THREADS", "VENV", "TEST_VENV", "PUBLISHED_PORT")
}


class LogLevel(StrEnum):
    """How much the service tells."""

    debug = "debug"
    info = "info"
    warning = "warning"
    error = "error"


class LogFormat(StrEnum):
    """For people, or one JSON object per line."""

    console = "console"
    json = "json"


def serve(
    ctx: typer.Context,
    host: Annotated[str | None, typer.Option(help="Address to listen on; 0.0.0.0 for all.")] = None,
    port: Annotated[int | None, typer.Option(min=1, max=65535, help="Port to listen on.")] = None,
    data_dir: Annotated[Path | None, typer.Option(file_okay=False, help="Folder for scans and map records.")] = None,
    storage: Annotated[
        str | None, typer.Option(help="Bucket for scans and map records, such as s3://bucket/prefix.")
    ] = None,
    redis_url: Annotated[str | None, typer.Option(help="Redis to use; without it the service starts its own.")] = None,
    ray_address: Annotated[
        str | None, typer.Option(help="Ray cluster that runs the workers; without it the service starts its own.")
    ] = None,
    num_workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, help="Number of workers; default: one per GPU, else one per CPU socket."),
    ] = None,
    log_level: Annotated[LogLevel | None, typer.Option(help="Log level.")] = None,
    log_format: Annotated[LogFormat | None, typer.Option(help="Readable lines, or JSON.")] = None,
) -> int:
    """Start the service in the foreground. Ctrl-C or SIGTERM stops it once running work is done.

    Options override PANOLOC_ environment variables; docs/operations.md lists all settings.
    """
    given = {
        "host": host,
        "port": port,
        "data_dir": data_dir,
        "storage": storage,
        "redis_url": redis_url,
        "ray_address": ray_address,
        "num_workers": num_workers,
        "log_level": log_level,
        "log_format": log_format,
    }
    return run_with({name: value for name, value in given.items() if value is not None}, ctx.obj)


def run_with(overrides: dict[str, Any], session: Session) -> int:
    """Read the settings, then run until stopped.

    A wrong setting is a usage error that names it; an address that cannot be listened on is told before anything starts.
    """
    from pydantic import ValidationError

    from panoloc.service.settings import Settings

    for sentence in unknown_settings(os.environ):
        session.messages.print(f"[yellow]Warning:[/] {sentence}")
    try:
        settings = Settings(**overrides)
    except ValidationError as error:
        for problem in error.errors():
            session.messages.print(_explain(problem["loc"], problem["msg"], problem["input"]), markup=False)
        return ExitCode.USAGE
    if settings.redis_url is not None and (fault := _fault_of_redis_url(settings.redis_url)):
        session.messages.print(f"Setting PANOLOC_REDIS_URL: {fault}", markup=False)
        return ExitCode.USAGE
    if settings.ray_address is not None and (fault := _fault_of_ray_address(settings.ray_address)):
        session.messages.print(f"Setting PANOLOC_RAY_ADDRESS or RAY_ADDRESS: {fault}", markup=False)
        return ExitCode.USAGE
    # Before Redis and the workers start.
    fault = why_not_free(settings.host, settings.port)
    if fault is not None:
        session.messages.print(
            f"The service cannot start: {fault}. --host and --port, or PANOLOC_HOST and PANOLOC_PORT, set another "
            "address.",
            markup=False,
        )
        return ExitCode.ERROR
    from panoloc.service.serve import run_service

    return int(run_service(settings) or 0)


def _fault_of_redis_url(url: str) -> str | None:
    """Return what is wrong with a URL, without the password in it."""
    from redis.asyncio.connection import parse_url

    try:
        parse_url(url)
    except ValueError as error:
        return f"expected redis://host:port/0, rediss:// or unix:///socket, got a URL that the Redis client refuses: {error}"
    return None


def _fault_of_ray_address(address: str) -> str | None:
    """Return what is wrong with an address that no cluster can have; one that does not answer is tried again."""
    if importlib.util.find_spec("ray") is None:
        return (
            'expected an installation of Ray, got none: pip install "panoloc[ray]"; '
            "or unset it to run the workers on this machine"
        )
    host, _, port = address.rpartition(":")
    if address == "auto" or (host and port.isdecimal() and 0 < int(port) < 2**16):
        return None
    return f"expected host:port of the cluster's head, such as ray.example:6379, or auto, got {address!r}"


def unknown_settings(environment: Mapping[str, str]) -> list[str]:
    """Return a sentence for each variable that looks like a setting and is none, with the one that was probably meant."""
    from panoloc.service.settings import Settings

    known = {f"PANOLOC_{name.upper()}" for name in Settings.model_fields} | _OF_OTHER_COMMANDS
    found = []
    for name in sorted(set(environment) - known):
        if name.startswith("PANOLOC_"):
            near = difflib.get_close_matches(name, known, 1, cutoff=0.85)
            found.append(f"{name} is no setting" + (f"; did you mean {near[0]}?" if near else "; it has no effect."))
    return found


def _explain(location: tuple[int | str, ...], message: str, given: object) -> str:
    if (
        not location
    ):  # several settings that do not go together: what was given are all of them, keys and passwords among them
        return f"Settings: {message.removeprefix('Value error, ')}"
    variable = "PANOLOC_" + ".".join(map(str, location)).removeprefix("panoloc_").upper()
    # Keys must not end up in the log of whatever started the service, nor passwords in a URL.
    is_secret = "KEY" in variable or "@" in str(given)
    shown = "" if is_secret or ", got " in message else f", got {given!r}"
    return f"Setting {variable}: {message.removeprefix('Value error, ')}{shown}"
