"""Messages of a sandboxed reader: JSON lines; a chunk is followed by its arrays as raw bytes. Nothing is executed."""

import json
from collections.abc import Callable
from typing import Any, BinaryIO

import numpy as np

from panoloc.core.errors import ScanDamagedError
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk

Message = dict[str, Any]
MAX_LINE_BYTES = 1 << 16
_COLOR_TYPES = ("|u1", "<u2", "<f8")


def send(stream: BinaryIO, message: Message) -> None:
    """Write one message without arrays."""
    stream.write(json.dumps(message).encode() + b"\n")
    stream.flush()


def send_chunk(stream: BinaryIO, chunk: RawChunk) -> None:
    """Write a chunk in pieces of at most CHUNK_ROWS rows."""
    for start in range(0, len(chunk.positions), CHUNK_ROWS):
        positions = np.ascontiguousarray(chunk.positions[start : start + CHUNK_ROWS], "<f8")
        colors = np.ascontiguousarray(chunk.colors[start : start + CHUNK_ROWS])
        colors = colors.astype(colors.dtype.newbyteorder("<"), copy=False)
        send(
            stream,
            {"kind": "chunk", "rows": len(positions), "colors": colors.dtype.str, "fraction": float(chunk.fraction)},
        )
        stream.write(positions.tobytes())
        stream.write(colors.tobytes())
        stream.flush()


def parse(line: bytes) -> Message:
    """Return a message. Raises ScanDamagedError for anything else: the reader is out of control."""
    try:
        message = json.loads(line)
    except ValueError as error:
        raise _nonsense() from error
    if not isinstance(message, dict) or not isinstance(message.get("kind"), str):
        raise _nonsense()
    return message


def receive_chunk(message: Message, take: Callable[[int], bytearray]) -> RawChunk:
    """Return the chunk that `message` announces. take: returns the next bytes. Raises ScanDamagedError."""
    rows, colors, fraction = message.get("rows"), message.get("colors"), message.get("fraction")
    is_plausible = isinstance(rows, int) and 0 < rows <= CHUNK_ROWS and isinstance(fraction, float)
    if not is_plausible or colors not in _COLOR_TYPES:
        raise _nonsense()
    assert isinstance(rows, int)
    assert isinstance(fraction, float)
    positions = np.frombuffer(take(rows * 24), np.float64).reshape(rows, 3)
    dtype = np.dtype(colors)
    return RawChunk(positions, np.frombuffer(take(rows * 3 * dtype.itemsize), dtype).reshape(rows, 3), fraction)


def _nonsense() -> ScanDamagedError:
    return ScanDamagedError("The reader of the file failed while reading it. Export the scan again.")
