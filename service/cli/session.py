"""What every command shares: the two consoles, the way to the service, and the JSON switch."""

import json
import os
from dataclasses import dataclass, field
from typing import Any

import httpx
from rich.console import Console

from service.client import PanolocClient


@dataclass
class Session:
    """State of one run of the command line.

    json_output: results go to standard output as one JSON document per line, and nothing else does.
    transport: replaces the network, for tests.
    """

    transport: httpx.BaseTransport | None = None
    json_output: bool = False
    results: Console = field(default_factory=lambda: Console(highlight=False, soft_wrap=not _is_terminal(1)))
    messages: Console = field(
        default_factory=lambda: Console(stderr=True, highlight=False, soft_wrap=not _is_terminal(2))
    )

    def client(self, url: str) -> PanolocClient:
        """Return a client of the service at `url`, with the key from PANOLOC_API_KEY when it is set."""
        return PanolocClient(url, api_key=os.environ.get("PANOLOC_API_KEY"), transport=self.transport)

    def print_json(self, document: Any) -> None:
        """Print one JSON document on one line of standard output."""
        self.results.file.write(json.dumps(document, ensure_ascii=False) + "\n")
        self.results.file.flush()


def _is_terminal(descriptor: int) -> bool:
    return os.isatty(descriptor)
