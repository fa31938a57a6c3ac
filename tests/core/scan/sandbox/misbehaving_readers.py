"""Readers that do what parsers of hostile files do."""

import ctypes
import os
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from panoloc.core.errors import ScanDamagedError
from panoloc.core.scan.reading_context import RawChunk, ReadingContext


def _chunk(num_points: int = 10) -> RawChunk:
    return RawChunk(np.arange(num_points * 3.0).reshape(-1, 3), np.full((num_points, 3), 7, np.uint16), 0.5)


def well_behaved(context: ReadingContext) -> Iterator[RawChunk]:
    print("what a library prints is no message")
    context.note("few_points", "seen", "warning")
    context.coordinate_system = "EPSG:25832"
    yield _chunk(2_500_000)


def refusing(context: ReadingContext) -> Iterator[RawChunk]:
    yield _chunk()
    raise ScanDamagedError("line 7 is odd")


def crashing(context: ReadingContext) -> Iterator[RawChunk]:
    yield _chunk()
    ctypes.string_at(0)


def exiting(context: ReadingContext) -> Iterator[RawChunk]:
    os._exit(3)
    yield _chunk()


def greedy(context: ReadingContext) -> Iterator[RawChunk]:
    yield RawChunk(np.ones((1 << 36, 3)), np.ones((1, 3), np.uint8), 0.0)


def endless(context: ReadingContext) -> Iterator[RawChunk]:
    yield _chunk()
    while True:
        pass


def silent(context: ReadingContext) -> Iterator[RawChunk]:
    time.sleep(100)
    yield _chunk()


def nesting(context: ReadingContext) -> Iterator[RawChunk]:
    yield from nesting(context)


def writing(context: ReadingContext) -> Iterator[RawChunk]:
    Path("/tmp/panoloc-box-test").write_bytes(b"harm")
    yield _chunk()


def connecting(context: ReadingContext) -> Iterator[RawChunk]:
    socket.create_connection(("127.0.0.1", 1))
    yield _chunk()


def executing(context: ReadingContext) -> Iterator[RawChunk]:
    subprocess.run(["/bin/true"], check=True)
    yield _chunk()


def killing(context: ReadingContext) -> Iterator[RawChunk]:
    os.kill(os.getppid(), 0)
    yield _chunk()


def telling_secrets(context: ReadingContext) -> Iterator[RawChunk]:
    raise ScanDamagedError(f"{sorted(name for name in os.environ if 'TOKEN' in name or 'PANOLOC' in name)}")
    yield _chunk()


def babbling(context: ReadingContext) -> Iterator[RawChunk]:
    os.write(max(int(name) for name in os.listdir("/proc/self/fd") if _is_pipe(name)), b"[" * 200_000)
    yield _chunk()


def _is_pipe(name: str) -> bool:
    try:
        return os.readlink(f"/proc/self/fd/{name}").startswith("pipe:")
    except OSError:
        return False
