"""What is sent to the service, block by block, and what comes back from it."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import httpx

from panoloc.service.client.errors import ApiProblemError, UnexpectedReplyError

JsonObject = dict[str, Any]
UploadProgress = Callable[[int, int], None]
"""Called with (bytes sent, bytes in all)."""


class ProgressFile(io.BufferedReader):
    """A file that reports (bytes read, bytes in all) after each block that httpx reads to send it."""

    def __init__(self, path: Path, progress: UploadProgress | None) -> None:
        super().__init__(io.FileIO(path))
        self._progress = progress
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """Return the next block, and report it."""
        block = super().read(size)
        if self._progress is not None:
            self._progress(self.tell(), self._size)
        return block


def raise_problem(reply: httpx.Response) -> NoReturn:
    """Raise ApiProblemError for a reply that is no success, UnexpectedReplyError where it is not of this service."""
    try:
        problem = reply.json()
    except ValueError:
        problem = None
    if not isinstance(problem, dict) or not {"detail", "title"} & problem.keys():
        raise UnexpectedReplyError(
            f"Expected an answer of panoloc from {reply.url}, got HTTP {reply.status_code} "
            f"({reply.headers.get('content-type', 'no content type')}); check --url and any proxy in between."
        )
    retry_after = reply.headers.get("retry-after", "")
    raise ApiProblemError(reply.status_code, problem, float(retry_after) if retry_after.isdigit() else None)


def json_object(reply: httpx.Response) -> JsonObject:
    """Return the object in a reply. Raises UnexpectedReplyError."""
    try:
        body = reply.json()
    except ValueError:
        body = None
    if not isinstance(body, dict):
        raise UnexpectedReplyError(
            f"Expected a JSON object from {reply.url}, got something else; check that panoloc answers there."
        )
    return body


def reason(error: httpx.HTTPError) -> str:
    """Return what went wrong, in a few words."""
    return str(error) or type(error).__name__
