"""The process of a sandboxed reader: `python -m panoloc.core.scan.sandbox.child`, started by
`panoloc.core.scan.sandbox.reading`."""

import dataclasses
import importlib
import json
import os
import sys
import threading
from pathlib import Path
from typing import Any, BinaryIO

from panoloc.core.errors import ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading_context import ReadingContext, ScanReader
from panoloc.core.scan.sandbox.limits import SandboxLimits, take_limits
from panoloc.core.scan.sandbox.messages import send, send_chunk
from panoloc.core.scan.sandbox.system_calls import refuse_system_calls

_LONGEST_MESSAGE = 2000


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
        send(stream, {"kind": "error", "error": type(error).__name__, "message": str(error)[:_LONGEST_MESSAGE]})
    except (MemoryError, RecursionError) as error:
        send(stream, {"kind": "error", "error": type(error).__name__, "message": ""})
    except Exception as error:
        send(stream, {"kind": "error", "error": "Exception", "message": f"{type(error).__name__}: {error}"[:200]})


def _end_with_parent() -> None:
    """Watch the parent: standard input ends when it dies, however it dies."""
    while os.read(0, 1):
        pass
    os._exit(1)


def _read(job: dict[str, Any], stream: BinaryIO) -> None:
    path, folder = Path(job["path"]), job["folder"]
    context = ReadingContext(
        path, ScanOptions(**job["options"]), path.stat().st_size, folder=None if folder is None else Path(folder)
    )
    for chunk in _reader_of(job["reader"])(context):
        send_chunk(stream, chunk)
    for found in context.diagnostics:
        send(stream, {"kind": "note", **dataclasses.asdict(found)})
    send(stream, {"kind": "end", "coordinate_system": context.coordinate_system})


def _reader_of(name: str) -> ScanReader:
    if ":" in name:
        module, _, function = name.partition(":")
        found: ScanReader = getattr(importlib.import_module(module), function)
        return found
    from panoloc.core.scan.reading import READERS

    return READERS[name]


if __name__ == "__main__":
    main()
