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
from panoloc.core.scan.reading_context import ReadingContext
from panoloc.core.scan.sandbox.limits import SandboxLimits, refuse_system_calls, take_limits
from panoloc.core.scan.sandbox.messages import send, send_chunk

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
        send(stream, "error", error=type(error).__name__, message=str(error)[:_LONGEST_MESSAGE])
    except (MemoryError, RecursionError) as error:
        send(stream, "error", error=type(error).__name__, message="")
    except Exception as error:
        send(stream, "error", error="Exception", message=f"{type(error).__name__}: {error}"[:200])


def _end_with_parent() -> None:
    """Watch the parent: standard input ends when it dies, however it dies."""
    while os.read(0, 1):
        pass
    os._exit(1)


def _read(job: dict[str, Any], stream: BinaryIO) -> None:
    from panoloc.core.scan.reading import READERS

    path, folder = Path(job["path"]), job["folder"] and Path(job["folder"])
    context = ReadingContext(path, ScanOptions(**job["options"]), path.stat().st_size, folder=folder)
    module, _, name = job["reader"].rpartition(":")
    reader = getattr(importlib.import_module(module), name) if module else READERS[name]
    for chunk in reader(context):
        send_chunk(stream, chunk)
    for found in context.diagnostics:
        send(stream, "note", **dataclasses.asdict(found))
    send(stream, "end", coordinate_system=context.coordinate_system)


if __name__ == "__main__":
    main()
