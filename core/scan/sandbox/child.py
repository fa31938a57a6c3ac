"""The process of a sandboxed reader: `python -m panoloc.core.scan.sandbox.child`, started by `read_in_sandbox`.

It gives up memory, time, files and system calls for good before it reads.
"""

import dataclasses
import importlib
import json
import os
import sys
import threading
from pathlib import Path
from typing import Any, BinaryIO

from numpy.typing import NDArray

from panoloc.core.errors import ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.sandbox import SandboxLimits, refuse_system_calls, take_limits
from panoloc.core.scan.reading_context import CHUNK_ROWS, SAID, RawChunk, ReadingContext

_LONGEST_MESSAGE = 2000
# laspy loads them where it can, for what no reader uses; that takes half of the time of a small scan.
_NEEDLESS = ("pyproj", "requests")


def main() -> None:
    """Read the scan that the argument describes as JSON, and send its points to standard output."""
    job: dict[str, Any] = json.loads(sys.argv[1])
    # Whatever a library prints must not get between the messages.
    stream = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    take_limits(SandboxLimits(**job["limits"]))
    refuse_system_calls()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        _read(job, stream)
    except ScanError as error:
        _send(stream, "error", error=type(error).__name__, message=str(error)[:_LONGEST_MESSAGE])
    except (MemoryError, RecursionError) as error:
        _send(stream, "error", error=type(error).__name__, message="")
    except Exception as error:
        _send(stream, "error", error="Exception", message=f"{type(error).__name__}: {error}"[:200])


def _end_with_parent() -> None:
    """Watch the parent: standard input ends when it dies, however it dies."""
    while os.read(0, 1):
        pass
    os._exit(1)


def _read(job: dict[str, Any], stream: BinaryIO) -> None:
    from panoloc.core.scan.reading import READERS

    sys.modules.update(dict.fromkeys(_NEEDLESS))  # type: ignore[arg-type]  # None: not to be had
    path, folder = Path(job["path"]), job["folder"] and Path(job["folder"])
    context = ReadingContext(path, ScanOptions(**job["options"]), path.stat().st_size, folder=folder)
    module, _, name = job["reader"].rpartition(":")
    reader = getattr(importlib.import_module(module), name) if module else READERS[name]
    for chunk in reader(context):
        _send_chunk(stream, chunk)
    for found in context.diagnostics:
        _send(stream, "note", **dataclasses.asdict(found))
    said = {name: getattr(context, name) for name in SAID}
    _send(stream, "end", **said)


def _send(stream: BinaryIO, kind: str, *arrays: NDArray[Any], **fields: Any) -> None:
    """Write a message: a line of JSON, then the arrays of a chunk as raw bytes. Nothing of it is executed."""
    stream.write(json.dumps({"kind": kind, **fields}).encode() + b"\n")
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def _send_chunk(stream: BinaryIO, chunk: RawChunk) -> None:
    """Write a chunk in pieces of at most CHUNK_ROWS rows."""
    color_type = chunk.colors.dtype.newbyteorder("<")
    for start in range(0, len(chunk.positions), CHUNK_ROWS):
        positions = chunk.positions[start : start + CHUNK_ROWS].astype("<f8", copy=False)
        colors = chunk.colors[start : start + CHUNK_ROWS].astype(color_type, copy=False)
        fields = {"rows": len(positions), "colors": color_type.str, "fraction": float(chunk.fraction)}
        _send(stream, "chunk", positions, colors, **fields)


if __name__ == "__main__":
    main()
