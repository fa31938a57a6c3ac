"""Options that several commands share."""

import os
from typing import Annotated

import typer


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
