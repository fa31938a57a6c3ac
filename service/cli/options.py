"""Options that several commands share."""

from typing import Annotated

import typer

DEFAULT_URL = "http://127.0.0.1:8000"

UrlOption = Annotated[str, typer.Option("--url", envvar="PANOLOC_URL", help="Where the service listens.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document per result on standard output, and nothing else there.")
]
