"""A Redis of the tests' own, for the tests of a process, for one of them, or for a campaign."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from panoloc.service.host.embedded_redis import EmbeddedRedis


@contextmanager
def started_redis(max_memory_bytes: int = 64 * 2**20) -> Iterator[EmbeddedRedis]:
    """Run an empty Redis for a while. pytest's own folders are too long for a socket."""
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        server = EmbeddedRedis(Path(folder), max_memory_bytes)
        server.start()
        try:
            yield server
        finally:
            server.stop()
