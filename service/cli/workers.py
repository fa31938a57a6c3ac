"""`panoloc workers`: bring the workers up on a Ray cluster."""

from typing import Annotated

import typer

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import Session


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
