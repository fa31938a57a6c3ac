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
        int | None, typer.Option("--workers", min=1, help="Workers; one per GPU, or one per machine without GPUs.")
    ] = None,
) -> int:
    """Bring the workers up on a Ray cluster, or change how many there are, and return once they are up.

    API replicas (panoloc serve with PANOLOC_RAY_ADDRESS) find them by name. PANOLOC_REDIS_URL and PANOLOC_STORAGE, or PANOLOC_DATA_DIR
    on a disk that all machines share, have to be those of the API replicas.
    """
    session: Session = ctx.obj
    try:
        from panoloc.service.ray.application import deploy, plan_of_environment
    except ModuleNotFoundError as error:
        if error.name != "ray":
            raise
        session.messages.print('[bold red]Error:[/] expected Ray, which is not installed: pip install "panoloc\\[ray]"')
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
