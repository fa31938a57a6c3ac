"""A service of its own to look at, with nothing in it, for as long as it is needed."""

import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from lab.background_service import start_in_background, wait_until_ready
from service.client import PanolocClient


@dataclass(frozen=True)
class OwnService:
    """folder: where photos and the like may be put. data_dir: of the service. process_id: of the process that began all others."""

    url: str
    client: PanolocClient
    folder: Path
    data_dir: Path
    process_id: int


@contextmanager
def own_service() -> Iterator[OwnService]:
    """Start a service, wait until it is ready, and stop it at the end."""
    with ExitStack() as stack:
        # A longer path would be too long for the sockets of a service.
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pl-", ignore_cleanup_errors=True)))
        url, data_dir = f"http://127.0.0.1:{free_port()}", folder / "data"
        service = start_in_background(url, folder / "service.log", {"PANOLOC_DATA_DIR": str(data_dir)})
        stack.callback(service.stop)
        client = stack.enter_context(PanolocClient(url))
        wait_until_ready(client, service, lambda _: None)
        yield OwnService(url, client, folder, data_dir, service.process_id)


def free_port() -> int:
    """Return a port of this machine that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
