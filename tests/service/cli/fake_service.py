"""A fake service behind httpx.MockTransport: it keeps what was sent and answers as the HTTP contract says."""

import copy
import io
import json
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from email.message import Message
from email.parser import BytesParser
from typing import Any

import httpx

from panoloc.service.http.schemas.examples import LOCALIZATION_EXAMPLE, MAP_EXAMPLE, QUEUED_MAP_EXAMPLE

READY_MAP: dict[str, Any] = {**MAP_EXAMPLE, "id": "map_1", "name": "office"}
POINTS = b"""ply
format ascii 1.0
element vertex 2
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
0 0 0 10 20 30
4 5 2 40 50 60
"""


def answer_with(status: str) -> dict[str, Any]:
    """Return an answer of `POST /localize` with the given status, to a panorama."""
    pose: dict[str, Any] = copy.deepcopy(LOCALIZATION_EXAMPLE["pose"])
    motion = pose["map_from_camera"]
    motion["position_m"] = {"x": 1.25, "y": 0.5, "z": 1.5}
    motion["matrix"] = [[1.0, 0.0, 0.0, 1.25], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 1.0, 1.5], [0.0, 0.0, 0.0, 1.0]]
    found = None if status == "not_localized" else pose
    return {
        **LOCALIZATION_EXAMPLE,
        "id": "loc_1",
        "status": status,
        "map_id": "map_1",
        "pose": found,
        "map_from_session": found and motion,
        "images": [{"pose": found, "agreement": 0.7, "camera": {"model": "equirectangular", "hfov_deg": 360.0}}],
        "artifacts": {"score_map_2d": "/localizations/loc_1/score-map-2d.png"},
    }


@dataclass
class FakeService:
    """Answers requests from a table; `fail_with` makes it answer everything with a problem.

    on_request: sees each request first, and may answer it.
    batches: options of those that were made, or refused with batch_refusal. batch_items: images of each, page by page.
    busy: so many queries are refused with 429. answers: to images with these words in them. at_maps: answer instead
    for maps of these ids. requests: (method, path) in order. parts: the multipart fields of the last upload, by name.
    """

    status: str = "localized"
    answer: dict[str, Any] | None = None
    places: list[dict[str, Any]] = field(default_factory=lambda: [READY_MAP])
    on_request: Callable[[httpx.Request], httpx.Response | None] = lambda request: None
    fail_with: httpx.Response | None = None
    refuse_file: str | None = None
    refusal: httpx.Response | None = None
    busy: int = 0
    answers: dict[str, dict[str, Any]] = field(default_factory=dict)
    at_maps: dict[str, httpx.Response | BaseException] = field(default_factory=dict)
    down: bool = False
    requests: list[tuple[str, str]] = field(default_factory=list)
    parts: dict[str, list[bytes]] = field(default_factory=dict)
    polls: list[dict[str, Any]] = field(default_factory=list)
    batches: list[dict[str, Any]] = field(default_factory=list)
    batch_refusal: httpx.Response | None = None
    batch_items: list[list[dict[str, Any]]] = field(default_factory=lambda: [[]])

    def handle(self, request: httpx.Request) -> httpx.Response:
        """Answer one request."""
        if self.down:
            raise httpx.ConnectError("Connection refused", request=request)
        path = request.url.path
        self.requests.append((request.method, str(request.url).removeprefix("http://127.0.0.1:8000")))
        if request.method == "POST" and not path.endswith(("/links", "/batches")):
            self.parts = multipart_fields(request)
        if (reply := self.on_request(request)) is not None:
            return reply
        if self.fail_with is not None:
            return self.fail_with
        instead = self.at_maps.get(path.removeprefix("/maps/"))
        if isinstance(instead, BaseException):
            raise instead
        if instead is not None:
            return instead
        if path.endswith("/links"):
            url = json.loads(request.content)["service_url"] + path.replace("/maps/", "/m/").removesuffix("/links")
            return httpx.Response(200, json={"url": f"{url}#key=pk_1", "key_id": "key_1", "qr_svg": "<svg/>"})
        return self._routes()[request.method, re.sub(r"/(map_.*|batch_\d+)$", "", path)](request)

    def _routes(self) -> dict[tuple[str, str], Callable[[httpx.Request], httpx.Response]]:
        return {
            ("GET", "/health/live"): lambda _: httpx.Response(200, json={"status": "live"}),
            ("GET", "/health/ready"): lambda _: httpx.Response(200, json={"status": "ready"}),
            ("POST", "/maps"): lambda _: httpx.Response(202, json={**QUEUED_MAP_EXAMPLE, "id": "map_1"}),
            ("GET", "/maps"): self._get_maps,
            ("DELETE", "/maps"): lambda _: httpx.Response(204),
            ("PATCH", "/maps"): lambda request: httpx.Response(200, json={**READY_MAP, **json.loads(request.content)}),
            ("POST", "/localize"): self._localize,
            ("POST", "/batches"): self._make_batch,
            ("GET", "/batches"): self._get_batch,
            ("GET", "/batches/batch_1/export"): self._export,
            ("GET", "/localizations/loc_1/score-map-2d.png"): lambda _: httpx.Response(200, content=b"a picture"),
        }

    def _get_maps(self, request: httpx.Request) -> httpx.Response:
        if request.url.path.endswith("/points"):
            return httpx.Response(200, content=POINTS)
        if request.url.path != "/maps":
            return httpx.Response(200, json=self.polls.pop(0) if self.polls else READY_MAP)
        first = int(request.url.params.get("cursor", 0))
        following = str(first + 1) if first + 1 < len(self.places) else None
        return httpx.Response(200, json={"items": self.places[first : first + 1], "next_cursor": following})

    def _export(self, request: httpx.Request) -> httpx.Response:
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as archive:
            archive.writestr("query.txt", str(request.url.query, "ascii"))
        return httpx.Response(200, content=out.getvalue())

    def _get_batch(self, request: httpx.Request) -> httpx.Response:
        number = int(request.url.params.get("cursor", 0))
        following = str(number + 1) if number + 1 < len(self.batch_items) else None
        return httpx.Response(200, json={"items": self.batch_items[number], "next_cursor": following})

    def _make_batch(self, request: httpx.Request) -> httpx.Response:
        options = json.loads(multipart_fields(request)["options"][0])
        self.batches.append(options)
        return self.batch_refusal or httpx.Response(
            202, json={"id": f"batch_{len(self.batches)}", "name": options["name"]}
        )

    def _localize(self, request: httpx.Request) -> httpx.Response:
        if self.refuse_file and self.refuse_file.encode() in b"".join(self.parts["image"]):
            return self.refusal or problem(422, "Not a panorama", "expected 2:1, got 3000 x 2000; crop it.")
        if self.busy > 0:
            self.busy -= 1
            return problem(429, "Too many requests wait", "try again", **{"Retry-After": "0"})
        for name, answer in self.answers.items():
            if name.encode() in b"".join(self.parts["image"]):
                return httpx.Response(200, json=answer)
        return httpx.Response(200, json=self.answer or answer_with(self.status))


def problem(status: int, title: str, detail: str, kind: str = "x", **headers: str) -> httpx.Response:
    """Return a problem document as the service sends it."""
    body = {"type": f"/problems/{kind}", "title": title, "status": status, "detail": detail, "request_id": "req_7"}
    return httpx.Response(status, json=body, headers={"content-type": "application/problem+json", **headers})


def multipart_fields(request: httpx.Request) -> dict[str, list[bytes]]:
    """Return the multipart fields of a request by name, through the standard library's own parser."""
    head = f"Content-Type: {request.headers['content-type']}\r\n\r\n".encode()
    fields: dict[str, list[bytes]] = {}
    message = BytesParser().parsebytes(head + request.read())
    parts: list[Message] = message.get_payload()  # type: ignore[assignment]
    for part in parts:
        name = str(part.get_param("name", header="content-disposition"))
        content = part.get_payload(decode=True)
        assert isinstance(content, bytes)
        fields.setdefault(name, []).append(content)
    return fields
