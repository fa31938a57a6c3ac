"""Starts a service in the background for `panoloc demo`, `panoloc bench` and the screenshots, and waits until it is ready."""

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from panoloc.service.client import ClientError, JsonClient, UnreachableError, WaitTimeoutError
from panoloc.service.host.address import why_not_free
from panoloc.service.host.child_processes import ending_with_parent

# A service is ready after seconds on an idle machine, after minutes where others start beside it.
_START_LIMIT_S = 600.0
_POLL_S = 0.25
_STOP_LIMIT_S = 30.0
_LOG_TAIL_LINES = 15


class StartError(ClientError):
    """The service could not be started."""


@dataclass(frozen=True)
class BackgroundService:
    """A service that this process started and that outlives it.

    log_file: everything that the service prints.
    """

    process: subprocess.Popen[bytes]
    log_file: Path

    def raise_if_ended(self) -> None:
        """Raise StartError with the end of the log when the process has ended."""
        code = self.process.poll()
        if code is not None:
            lines = self.log_file.read_text(encoding="utf-8", errors="replace").splitlines()[-_LOG_TAIL_LINES:]
            tail = "\n".join([f"The end of {self.log_file}:", *(f"  {line}" for line in lines)])
            raise StartError(f"The service ended with exit code {code} while it started. {tail}")

    def stop(self) -> None:
        """Ask the process to end and wait for it; its child processes end with it."""
        self.process.terminate()
        try:
            self.process.wait(_STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()


@dataclass(frozen=True)
class OwnService:
    """A service that lives as long as a block.

    folder: temporary, for files to upload. process_id: of the service's first process.
    """

    url: str
    client: JsonClient
    folder: Path
    process_id: int


@contextmanager
def own_service(
    settings: Mapping[str, str] | None = None,
    log_file: Path | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Iterator[OwnService]:
    """Start an empty service on a free port, wait until it is ready, and stop it at the end, also when this process is killed.

    settings: further environment variables of the service. say: receives what it waits for.
    Raises StartError when the service ends while it starts.
    """
    with ExitStack() as stack:
        # Unix sockets allow 107 characters, so the folder's name is short.
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pl-", ignore_cleanup_errors=True)))
        url = f"http://127.0.0.1:{_free_port()}"
        told = {"PANOLOC_DATA_DIR": str(folder / "data"), **(settings or {})}
        service = start_in_background(url, log_file or folder / "service.log", told, survives=False)
        stack.callback(service.stop)
        client = stack.enter_context(JsonClient(url))
        wait_until_ready(client, service, say)
        yield OwnService(url, client, folder, service.process.pid)


def start_in_background(
    url: str, log_file: Path, settings: Mapping[str, str] | None = None, survives: bool = True
) -> BackgroundService:
    """Start `panoloc serve` for `url` in a session of its own. survives: whether it goes on when this process ends.

    settings: environment variables that differ from those of this process. Raises StartError when the URL is not of this machine,
    or another program listens there.
    """
    address = urlsplit(url)
    if address.hostname not in ("127.0.0.1", "localhost", "::1") or address.scheme != "http":
        raise StartError(f"No service answers at {url}, and only one on this machine can be started; start it there.")
    port = address.port or 80
    fault = why_not_free(address.hostname, port)
    if fault is not None:
        raise StartError(
            f"No service can be started at {url}: {fault}. Choose another port with --url, "
            "such as http://127.0.0.1:8001."
        )
    serve = ["-P", "-m", "panoloc.service.cli", "serve", "--host", address.hostname, "--port", str(port)]
    command = [sys.executable, *serve]
    log_file.parent.mkdir(parents=True, exist_ok=True)
    with log_file.open("wb") as log:
        process = subprocess.Popen(
            command if survives else ending_with_parent(command),
            stdin=subprocess.DEVNULL if survives else subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, **(settings or {})},
        )
    return BackgroundService(process, log_file)


def wait_until_ready(client: JsonClient, service: BackgroundService | None, on_state: Callable[[str], None]) -> None:
    """Poll until the service serves requests; `on_state` receives what it waits for.

    Raises StartError when `service` ends meanwhile and WaitTimeoutError after ten minutes.
    """
    give_up, missing = time.monotonic() + _START_LIMIT_S, "its process"
    while time.monotonic() < give_up:
        if service is not None:
            service.raise_if_ended()
        try:
            ready, details = client.readiness()
        except UnreachableError:
            if service is None:
                raise
        else:
            if ready:
                return
            waiting_for = details.get("waiting_for") or details.get("detail") or "something it does not name"
            missing = ", ".join(map(str, waiting_for)) if isinstance(waiting_for, list) else str(waiting_for)
        on_state(f"the service waits for {missing}")
        time.sleep(_POLL_S)
    raise WaitTimeoutError(f"The service was not ready after {_START_LIMIT_S:g} s; it still waits for {missing}.")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
