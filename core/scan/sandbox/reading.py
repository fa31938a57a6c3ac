"""Run a reader in the sandbox, with limits of memory and time."""

import contextlib
import dataclasses
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any, NoReturn

import numpy as np

import panoloc.core.errors
from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError
from panoloc.core.sandbox import SandboxLimits, sandbox_environment
from panoloc.core.scan.reading_context import CHUNK_ROWS, SAID, RawChunk, ReadingContext

_READ_BYTES = 1 << 20
_MAX_LINE_BYTES = 1 << 16
_COLOR_TYPES = ("|u1", "<u2", "<f8")
_SIMPLIFY = "Make the scan simpler (fewer triangles, smaller textures) or split it, and upload it again."
_EXPORT_AGAIN = "The file is damaged or malicious; export the scan again."


def read_in_sandbox(reader: str, context: ReadingContext, limits: SandboxLimits | None = None) -> Iterator[RawChunk]:
    """Yield the chunks of a reader; its notes and what the file says reach `context` at the end.

    reader: a format of `panoloc.core.scan.reading.READERS`, or "module:function".

    Raises the reader's own errors; ScanDamagedError when it crashes, ScanContentError when it exceeds `limits`.
    """
    sandbox = _Sandbox(reader, context, limits or SandboxLimits())
    try:
        while (message := sandbox.next_message())["kind"] != "end":
            if message["kind"] == "chunk":
                yield sandbox.take_chunk(message)
            elif message["kind"] == "note":
                context.note(str(message["code"]), str(message["message"]), str(message["severity"]))
            else:
                sandbox.fail(str(message.get("error")), str(message.get("message")))
        for name in SAID:
            setattr(context, name, message.get(name))
    finally:
        sandbox.close()


class _Sandbox:
    def __init__(self, reader: str, context: ReadingContext, limits: SandboxLimits) -> None:
        self._reader, self._limits = reader.rpartition(":")[2].upper(), limits
        job = {
            "reader": reader,
            "path": str(context.path),
            "folder": None if context.folder is None else str(context.folder),
            "options": dataclasses.asdict(context.options),
            "limits": dataclasses.asdict(limits),
        }
        # A session of its own: a terminal's interrupt is for the parent, which then ends the child.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "panoloc.core.scan.sandbox.child", json.dumps(job)],
            stdin=subprocess.PIPE,  # closed by the system when this process dies, which ends the child
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=sandbox_environment(),
            start_new_session=True,
        )
        assert self._process.stdout is not None
        self._pipe = self._process.stdout.fileno()
        self._pending = bytearray()

    def next_message(self) -> dict[str, Any]:
        """Return the next message. Raises as `read_in_sandbox` does when the process ends or falls silent."""
        while (end := self._pending.find(b"\n")) < 0:
            if len(self._pending) > _MAX_LINE_BYTES:
                raise self._crashed("it wrote no message")
            self._fill()
        line = bytes(self._pending[:end])
        del self._pending[: end + 1]
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict) or not isinstance(message.get("kind"), str):
            raise _nonsense()
        return message

    def take_chunk(self, message: dict[str, Any]) -> RawChunk:
        """Return the chunk that a message announces."""
        match message:
            case {"rows": int(rows), "colors": str(colors), "fraction": float(fraction)}:
                if 0 < rows <= CHUNK_ROWS and colors in _COLOR_TYPES:
                    positions = np.frombuffer(self._take(rows * 24), np.float64).reshape(rows, 3)
                    raw = self._take(rows * 3 * np.dtype(colors).itemsize)
                    return RawChunk(positions, np.frombuffer(raw, colors).reshape(rows, 3), fraction)
        raise _nonsense()

    def _take(self, num_bytes: int) -> bytearray:
        while len(self._pending) < num_bytes:
            self._fill()
        taken = self._pending[:num_bytes]
        del self._pending[:num_bytes]
        return taken

    def fail(self, kind: str, message: str) -> NoReturn:
        """Raise the error that the reader reported."""
        found = getattr(panoloc.core.errors, kind, None)
        if isinstance(found, type) and issubclass(found, ScanError):
            raise found(message)
        if kind == "MemoryError":
            raise ScanContentError(
                f"Reading the {self._reader} file takes more than {self._limits.memory_bytes / 2**30:.3g} GiB, "
                f"the memory limit of a reader. {_SIMPLIFY}"
            )
        if kind == "RecursionError":
            raise self._crashed("its structure is nested too deeply")
        raise self._crashed(message)

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def _fill(self) -> None:
        if not select.select([self._pipe], [], [], self._limits.silence_s)[0]:
            raise self._too_slow(self._limits.silence_s)
        data = os.read(self._pipe, _READ_BYTES)
        if not data:
            raise self._ended()
        self._pending += data

    def _ended(self) -> ScanError:
        """Return the error for a process that ended without a message."""
        code: int | None = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(timeout=10.0)
        # The soft limit of processor time kills with SIGXCPU, the hard one, which is the same, with SIGKILL.
        if code == -signal.SIGXCPU:
            return self._too_slow(self._limits.cpu_s)
        if code == -signal.SIGKILL:
            return ScanContentError(
                f"The reader of the {self._reader} file was ended by the system because of its time or memory use. "
                f"{_SIMPLIFY}"
            )
        return self._crashed(signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}")

    def _too_slow(self, seconds: float) -> ScanError:
        return ScanContentError(f"Reading the {self._reader} file takes longer than {seconds:g} s. {_SIMPLIFY}")

    def _crashed(self, how: str) -> ScanError:
        return ScanDamagedError(f"The {self._reader} file cannot be read: its reader failed ({how}). {_EXPORT_AGAIN}")


def _nonsense() -> ScanDamagedError:
    return ScanDamagedError("The reader of the file failed while reading it. Export the scan again.")
