"""`panoloc serve` and `panoloc workers`: start the service in the foreground, or its workers on a Ray cluster."""

import difflib
import importlib.util
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import typer

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import Session
from panoloc.service.host.address import why_not_free

# Variables that other commands, the scripts or the container image read.
_OF_OTHER_COMMANDS = {
    f"PANOLOC_{name}" for name in ("URL", "API_KEY", "EVAL_THREADS", "VENV", "TEST_VENV", "PUBLISHED_PORT")
}


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
    log_level: Annotated[
        Literal["debug", "info", "warning", "error"] | None, typer.Option(case_sensitive=False, help="Log level.")
    ] = None,
    log_format: Annotated[Literal["console", "json"] | None, typer.Option(help="Readable lines, or JSON.")] = None,
) -> int:
    """Start the service in the foreground. Ctrl-C or SIGTERM stops it once running work is done.

    Options override PANOLOC_ environment variables; docs/operations.md lists all settings.
    """
    from pydantic import ValidationError

    from panoloc.service.settings import Settings

    session: Session = ctx.obj
    for sentence in unknown_settings(os.environ):
        session.messages.print(f"[yellow]Warning:[/] {sentence}")
    try:
        # The names of the options are those of the settings.
        settings = Settings(**{name: value for name, value in ctx.params.items() if value is not None})
    except ValidationError as error:
        for problem in error.errors():
            session.messages.print(_explain(problem["loc"], problem["msg"], problem["input"]), markup=False)
        return ExitCode.USAGE
    fault = _fault_of_redis_url(settings.redis_url) or _fault_of_ray_address(settings.ray_address)
    if fault is not None:
        session.messages.print(f"Setting {fault}", markup=False)
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


def workers(
    ctx: typer.Context,
    ray_address: Annotated[
        str,
        typer.Option(envvar=["PANOLOC_RAY_ADDRESS", "RAY_ADDRESS"], help="The cluster's head as host:port, or auto."),
    ] = "auto",
    num_workers: Annotated[
        int | None,
        typer.Option(
            "--workers", min=1, help="Number of workers; default: one per GPU, or one per machine without GPUs."
        ),
    ] = None,
) -> int:
    """Start the workers on a Ray cluster, or change their number, and return once they are up.

    API replicas (panoloc serve with PANOLOC_RAY_ADDRESS) find them by name. Set PANOLOC_REDIS_URL as on the replicas,
    and also PANOLOC_STORAGE, or PANOLOC_DATA_DIR on a disk that all machines share.
    """
    session: Session = ctx.obj
    try:
        from panoloc.service.ray.application import deploy, plan_of_environment
    except ModuleNotFoundError as error:
        if error.name != "ray":
            raise
        session.messages.print(
            '[bold red]Error:[/] expected an installation of Ray, got none: pip install "panoloc\\[ray]"'
        )
        return ExitCode.ERROR
    try:
        plan = plan_of_environment()
    except ValueError as error:
        session.messages.print(f"Settings: {error}", markup=False)
        return ExitCode.USAGE
    try:
        running = deploy(ray_address, plan, num_workers)
    except (ConnectionError, RuntimeError) as error:
        session.messages.print(f"Error: no workers at Ray {ray_address}: {' '.join(str(error).split())}", markup=False)
        return ExitCode.UNREACHABLE
    session.messages.print(f"{running} workers are up.")
    return ExitCode.OK


def _fault_of_redis_url(url: str | None) -> str | None:
    """Return what is wrong with a URL, without the password in it."""
    from redis.asyncio.connection import parse_url

    try:
        parse_url(url or "redis://")
    except ValueError as error:
        wanted = "expected redis://host:port/0, rediss:// or unix:///socket"
        return f"PANOLOC_REDIS_URL: {wanted}, got a URL that the Redis client refuses: {error}"
    return None


def _fault_of_ray_address(address: str | None) -> str | None:
    """Return what is wrong with an address that no cluster can have; one that does not answer is tried again."""
    name = "PANOLOC_RAY_ADDRESS or RAY_ADDRESS"
    if address is not None and importlib.util.find_spec("ray") is None:
        return (
            f'{name}: expected an installation of Ray, got none: pip install "panoloc[ray]"; '
            "or unset it to run the workers on this machine"
        )
    host, _, port = (address or "auto").rpartition(":")
    if address in (None, "auto") or (host and port.isdecimal() and 0 < int(port) < 2**16):
        return None
    return f"{name}: expected host:port of the cluster's head, such as ray.example:6379, or auto, got {address!r}"


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
    # Without a place: settings that do not go together. What was given are all, keys and passwords among them.
    if not location:
        return f"Settings: {message.removeprefix('Value error, ')}"
    variable = "PANOLOC_" + ".".join(map(str, location)).removeprefix("panoloc_").upper()
    # Keys must not end up in the log of whatever started the service, nor passwords in a URL.
    is_secret = "KEY" in variable or "@" in str(given)
    shown = "" if is_secret or ", got " in message else f", got {given!r}"
    return f"Setting {variable}: {message.removeprefix('Value error, ')}{shown}"
