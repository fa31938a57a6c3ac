"""One request over HTTP: what is sent, and what is made of answers that are none."""

import json
import threading
from collections.abc import Iterator
from email import message_from_bytes
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from panoloc.ros2.estimate import Spread, Travel
from panoloc.ros2.frames import Frame
from panoloc.ros2.images import camera_entry
from panoloc.ros2.poses import Pose
from panoloc.ros2.service import NoAnswerError, Query, localize
from panoloc.service.http.schemas.queries import LocalizeOptions
from tests.ros2.small_world import TRUTH, camera_info

PLACE = Pose(np.eye(3), np.zeros(3))


def query(num: int = 2) -> Query:
    images = [SimpleNamespace(format="jpeg", data=b"\xff\xd8" + bytes([number])) for number in range(num)]
    frames = [Frame(1.0, each, camera_entry(camera_info(), PLACE), PLACE, Travel()) for each in images]
    return Query(tuple(frames), Spread(0.1, 0.2), (TRUTH, Spread(20.0, 3.0)))


class Handler(BaseHTTPRequestHandler):
    reply: ClassVar[tuple[int, dict[str, str], bytes]]
    seen: ClassVar[list[tuple[dict[str, str], bytes]]]

    def do_POST(self) -> None:
        self.seen.append((dict(self.headers), self.rfile.read(int(self.headers["Content-Length"]))))
        status, headers, body = self.reply
        self.send_response(status)
        for name, value in (headers | {"Content-Length": str(len(body))}).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: Any) -> None:
        pass


@pytest.fixture
def server() -> Iterator[str]:
    Handler.seen = []
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
        threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_address[1]}"
        running.shutdown()


def test_the_service_gets_a_form_with_map_options_and_images(server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOLOC_API_KEY", "secret")
    found: dict[str, Any] = {"status": "localized", "reasons": [], "warnings": [], "map_from_session": None}
    Handler.reply = 200, {}, json.dumps(found).encode()
    assert localize(server + "/", "map_a", query()) == found
    ((headers, body),) = Handler.seen
    assert headers["Authorization"] == "Bearer secret"
    form = message_from_bytes(f"Content-Type: {headers['Content-Type']}\r\n\r\n".encode() + body)
    parts: Any = form.get_payload()
    names = [part.get_param("name", header="content-disposition") for part in parts]
    assert names == ["map_id", "options", "image", "image"]
    assert parts[0].get_payload() == "map_a"
    assert [part.get_payload(decode=True) for part in parts[2:]] == [b"\xff\xd8\0", b"\xff\xd8\1"]
    sent = LocalizeOptions.model_validate_json(parts[1].get_payload(decode=True))
    assert sent.frame == "opencv"
    assert sent.session is not None
    assert sent.session.to_options().up_known
    assert sent.session.position_noise_m == pytest.approx(0.1)
    assert sent.hints is not None
    assert sent.hints.prior is not None
    # No surer, and no less sure, than the service can be told.
    assert sent.hints.prior.position_std_m == 10
    assert sent.hints.prior.orientation_std_deg == 60


@pytest.mark.parametrize(
    ("status", "headers", "after_s"),
    [(429, {"Retry-After": "7"}, 7), (503, {}, 2), (409, {}, 2), (504, {}, 2), (401, {}, 30), (422, {}, 30)],
)
def test_a_refusal_says_why_and_when_to_ask_again(
    server: str, status: int, headers: dict[str, str], after_s: float
) -> None:
    Handler.reply = status, headers, json.dumps({"detail": "the reason"}).encode()
    with pytest.raises(NoAnswerError, match=f"{status}: the reason") as caught:
        localize(server, "map_a", query())
    assert caught.value.retry_after_s == after_s


def test_a_service_that_is_away_or_is_none_is_asked_again_soon(server: str) -> None:
    Handler.reply = 200, {}, b"<html>"
    for url in (server, "http://127.0.0.1:1"):
        with pytest.raises(NoAnswerError, match=f"waiting for the service at {url}") as caught:
            localize(url, "map_a", query())
        assert caught.value.retry_after_s == 2
    Handler.reply = 502, {}, b"<html>"
    with pytest.raises(NoAnswerError, match="502"):
        localize(server, "map_a", query())
