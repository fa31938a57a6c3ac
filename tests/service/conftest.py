"""One S3 for the tests of a process, each with a prefix of its own."""

import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoloc.service.storage.bucket import BucketStorage
from tests.service.storage.bucket_server import BucketServer


@pytest.fixture(scope="session")
def bucket_server() -> Iterator[BucketServer]:
    server = BucketServer()
    yield server
    server.stop()


@pytest.fixture
def prefix() -> str:
    return uuid.uuid4().hex


@pytest.fixture
def bucket(bucket_server: BucketServer, prefix: str, tmp_path: Path) -> BucketStorage:
    return bucket_server.storage(tmp_path / "machine", prefix)
