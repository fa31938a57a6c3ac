"""An S3 of the tests' own: moto, in a process that can be stopped in the middle of anything."""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import obstore
from obstore.store import ObjectStore

from panoloc.service.storage import BucketAccess
from panoloc.service.storage.bucket import BucketStorage
from panoloc.service.storage.bucket_client import open_client

BUCKET = "scans"


class BucketServer:
    """Keeps everything in memory: it is gone when the process is."""

    def __init__(self) -> None:
        self.port = 0
        self.start()

    def start(self) -> None:
        """Start it, empty, on the port that it had."""
        with tempfile.TemporaryFile("w+b") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(self.port)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
            self.port = self._port_in(log)
        self.endpoint = f"http://127.0.0.1:{self.port}"
        self._ask(f"/{BUCKET}", "PUT")

    @property
    def variables(self) -> dict[str, str]:
        """Return what an operator would put into the environment."""
        return {
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ACCESS_KEY_ID": "an-id",
            "AWS_SECRET_ACCESS_KEY": "a-secret",
            "AWS_REGION": "us-east-1",
        }

    def storage(self, folder: Path, prefix: str = "panoloc", copies_bytes: int = 2**20) -> BucketStorage:
        """Return a storage in the bucket. folder: of its uploads and local copies."""
        access = BucketAccess(str(folder), copies_bytes, self.variables)
        return BucketStorage(f"s3://{BUCKET}/{prefix}", access)

    def client(self, prefix: str = "panoloc") -> ObjectStore:
        """Return a client of the bucket that bypasses the storage."""
        return open_client(f"s3://{BUCKET}/{prefix}", self.variables)

    def overwrite(self, prefix: str, key: str, data: bytes) -> None:
        """Put other bytes into an object and keep its metadata, as a fault of a disk would."""
        attributes = obstore.get(self.client(prefix), key).attributes
        obstore.put(self.client(prefix), key, data, attributes=attributes)

    @contextmanager
    def refusing(self, refuses: bool = True) -> Iterator[None]:
        """Refuse unknown keys, which all are, for a while."""
        if refuses:
            self._accept(0)
        try:
            yield
        finally:
            self._accept(10**9)

    @contextmanager
    def away(self) -> Iterator[None]:
        """Stop for a while; the bucket is empty afterwards."""
        self.stop()
        try:
            yield
        finally:
            self.start()

    def pause(self) -> None:
        """Let every request wait."""
        os.kill(self._process.pid, 19)

    def go_on(self) -> None:
        """Answer again."""
        os.kill(self._process.pid, 18)

    def stop(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()

    def _accept(self, num_requests: int) -> None:
        self._ask("/moto-api/reset-auth", "POST", json.dumps(num_requests).encode())

    def _ask(self, path: str, method: str = "GET", data: bytes | None = None) -> None:
        headers = {"Content-Type": "application/octet-stream"}
        request = urllib.request.Request(self.endpoint + path, data, headers, method=method)
        urllib.request.urlopen(request, timeout=30).close()

    def _port_in(self, log: IO[bytes]) -> int:
        """Wait for the line that names the port: another server may have one that was free a moment ago."""
        deadline = time.monotonic() + 200
        while True:
            text = os.pread(log.fileno(), 65536, 0).decode(errors="replace")
            if found := re.search(r"Running on http://127\.0\.0\.1:(\d+)", text):
                return int(found[1])
            is_over = self._process.poll() is not None or time.monotonic() > deadline
            assert not is_over, f"moto does not start: {text}"
            time.sleep(0.05)
