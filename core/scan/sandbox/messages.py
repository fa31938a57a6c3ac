"""Messages of a sandboxed reader: JSON lines; a chunk is followed by its arrays as raw bytes. Nothing is executed."""

import json
from collections.abc import Callable
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanDamagedError
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk

Message = dict[str, Any]
MAX_LINE_BYTES = 1 << 16
_COLOR_TYPES = ("|u1", "<u2", "<f8")


def send(stream: BinaryIO, kind: str, *arrays: NDArray[Any], **fields: Any) -> None:
    """Write one message."""
    stream.write(json.dumps({"kind": kind, **fields}).encode() + b"\n")
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def send_chunk(stream: BinaryIO, chunk: RawChunk) -> None:
    """Write a chunk in pieces of at most CHUNK_ROWS rows."""
    color_type = chunk.colors.dtype.newbyteorder("<")
    for start in range(0, len(chunk.positions), CHUNK_ROWS):
        positions = chunk.positions[start : start + CHUNK_ROWS].astype("<f8", copy=False)
        colors = chunk.colors[start : start + CHUNK_ROWS].astype(color_type, copy=False)
        fields = {"rows": len(positions), "colors": color_type.str, "fraction": float(chunk.fraction)}
        send(stream, "chunk", positions, colors, **fields)


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
    match message:
        case {"rows": int(rows), "colors": str(colors), "fraction": float(fraction)}:
            if 0 < rows <= CHUNK_ROWS and colors in _COLOR_TYPES:
                positions = np.frombuffer(take(rows * 24), np.float64).reshape(rows, 3)
                raw = take(rows * 3 * np.dtype(colors).itemsize)
                return RawChunk(positions, np.frombuffer(raw, colors).reshape(rows, 3), fraction)
    raise _nonsense()


def _nonsense() -> ScanDamagedError:
    return ScanDamagedError("The reader of the file failed while reading it. Export the scan again.")
