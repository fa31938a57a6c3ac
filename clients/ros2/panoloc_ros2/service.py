"""Asks the service where frames were taken: one request, and what to do where there is no answer."""

import http.client
import json
import os
import urllib.error
import urllib.request
import uuid
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from threading import Thread
from typing import Any

from .estimate import Spread
from .frames import Frame
from .images import file_of
from .poses import Pose, as_json

_TIMEOUT_S = 30.0
_AWAY_S, _REFUSED_S = 2.0, 30.0  # until the next request
_PASSING = (409, 429, 503, 504)
_FIELDS = {"status", "reasons", "warnings", "map_from_session"}


class NoAnswerError(Exception):
    """The service is away or busy, or refuses the request; the text says why."""

    def __init__(self, reason: str, retry_after_s: float) -> None:
        super().__init__(reason)
        self.retry_after_s = retry_after_s


@dataclass(frozen=True)
class Query:
    """frames: the newest first. noise: of the odometry between them. expected: map_from_camera of the first, and how sure that is."""

    frames: tuple[Frame, ...]
    noise: Spread
    expected: tuple[Pose, Spread] | None

    @property
    def options(self) -> dict[str, Any]:
        """Return the options of the request."""
        return {
            "frame": "opencv",
            "cameras": [frame.camera for frame in self.frames],
            "session": {
                "up": "known",
                "position_noise_m": min(self.noise.position_m, 1.0),
                "orientation_noise_deg": min(self.noise.angle_deg, 30.0),
            },
            "timeout_s": _TIMEOUT_S,
        } | ({} if self.expected is None else {"hints": {"prior": _prior(*self.expected)}})


def localize(url: str, map_id: str, query: Query) -> dict[str, Any]:
    """Return the answer. The environment variable PANOLOC_API_KEY holds the key, if the service wants one. Raises NoAnswerError."""
    boundary = uuid.uuid4().hex
    parts = [
        ('name="map_id"', map_id.encode()),
        ('name="options"', json.dumps(query.options).encode()),
        *((f'name="image"; filename="{number}"', file_of(each.image)) for number, each in enumerate(query.frames)),
    ]
    body = b"".join(
        f"--{boundary}\r\nContent-Disposition: form-data; {head}\r\n\r\n".encode() + content + b"\r\n"
        for head, content in parts
    )
    headers = {"Content-Type": f"multipart/form-data; boundary={boundary}"}
    if key := os.environ.get("PANOLOC_API_KEY"):
        headers["Authorization"] = f"Bearer {key}"
    try:
        request = urllib.request.Request(f"{url.rstrip('/')}/localize", body + f"--{boundary}--\r\n".encode(), headers)
        with urllib.request.urlopen(request, timeout=2 * _TIMEOUT_S) as reply:
            answer = json.load(reply)
        if not (isinstance(answer, dict) and answer.keys() >= _FIELDS):
            raise NoAnswerError(f"expected a panoloc service at {url}, got other answers", _REFUSED_S)
        return answer
    except urllib.error.HTTPError as error:
        with error:
            raise _refused(error) from error
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise NoAnswerError(f"waiting for the service at {url}: {error}", _AWAY_S) from error


Ask = Callable[[Query], "Future[dict[str, Any]]"]


def in_background(url: str, map_id: str) -> Ask:
    """Return a function that asks the service in a thread which does not outlive the process."""

    def ask(query: Query) -> "Future[dict[str, Any]]":
        future: Future[dict[str, Any]] = Future()

        def work() -> None:
            try:
                future.set_result(localize(url, map_id, query))
            except NoAnswerError as error:
                future.set_exception(error)
            except Exception as error:  # of one query; the robot drives on
                future.set_exception(NoAnswerError(f"the query failed: {error!r}", _REFUSED_S))

        Thread(target=work, daemon=True).start()
        return future

    return ask


def _refused(error: urllib.error.HTTPError) -> NoAnswerError:
    try:
        detail = json.load(error)["detail"]
    except (OSError, ValueError, LookupError):
        detail = error.reason
    try:
        after_s = float(error.headers.get("Retry-After", ""))
    except ValueError:
        after_s = _AWAY_S if error.code in _PASSING else _REFUSED_S
    return NoAnswerError(f"{error.code}: {detail}", after_s)


def _prior(map_from_camera: Pose, spread: Spread) -> dict[str, Any]:
    return {
        "pose": {"frame": "opencv", "map_from_camera": as_json(map_from_camera)},
        "position_std_m": min(spread.position_m, 10.0),
        "orientation_std_deg": min(spread.angle_deg, 60.0),
    }
