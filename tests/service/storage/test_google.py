"""Requests to Google's storage where they differ from S3: a write over a version names the generation."""

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from panoloc.service.errors import StoredFileChangedError
from panoloc.service.storage import BucketAccess, open_storage


class _Google(BaseHTTPRequestHandler):
    """One object, with a generation that counts its writes."""

    generation = 0
    body = b""
    digest = ""

    def do_PUT(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        wanted = self.headers.get("x-goog-if-generation-match")
        if wanted is not None and int(wanted) != _Google.generation:
            self._reply(412, b"")
            return
        _Google.generation, _Google.body = _Google.generation + 1, body
        _Google.digest = self.headers["x-goog-meta-sha256"]
        self._reply(200, b"")

    def do_GET(self) -> None:
        self._reply(206, _Google.body)

    def _reply(self, status: int, body: bytes) -> None:
        self.send_response(status)
        self.send_header("ETag", '"a-tag"')
        self.send_header("x-goog-meta-sha256", _Google.digest)
        self.send_header("x-goog-generation", str(_Google.generation))
        self.send_header("Last-Modified", "Mon, 05 Jan 2026 00:00:00 GMT")
        self.send_header("Content-Length", str(len(body)))
        if status == 206:
            self.send_header("Content-Range", f"bytes 0-{len(body) - 1}/{len(body)}")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Log nothing."""


@pytest.fixture
def google() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), _Google) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


def test_of_two_writes_over_the_same_generation_the_second_is_refused(google: str, tmp_path: Path) -> None:
    account = {
        "gcs_base_url": google,
        "disable_oauth": True,
        "client_email": "",
        "private_key": "",
        "private_key_id": "",
    }
    variables = {"GOOGLE_SERVICE_ACCOUNT_KEY": json.dumps(account), "GOOGLE_BASE_URL": google}
    storage = open_storage("gs://bucket", BucketAccess(str(tmp_path), 0, variables))
    storage.replace("maps/a/map.json", b"first")
    data, stamp = storage.read_stamped("maps/a/map.json")
    assert data == b"first"
    storage.replace("maps/a/map.json", b"second", stamp)
    with pytest.raises(StoredFileChangedError):
        storage.replace("maps/a/map.json", b"third", stamp)
    assert _Google.body == b"second"
