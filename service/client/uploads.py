"""Files as parts of a multipart form, and their progress while they are sent."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO

UploadProgress = Callable[[int, int], None]
"""Called with (bytes sent, bytes in all)."""


def paths_of(given: Path | Sequence[Path] | None) -> list[Path]:
    """Return the given files as a list."""
    if given is None:
        return []
    return [given] if isinstance(given, Path) else list(given)


def sendable(name: str) -> str:
    """Return a file name as valid UTF-8; other bytes become question marks."""
    return name.encode("utf-8", "replace").decode()


class ProgressFile:
    """Wraps an open file for httpx, which reads it in blocks while it sends.

    file: open for reading in binary. progress: called after every block; None for silence.
    """

    def __init__(self, file: BinaryIO, progress: UploadProgress | None) -> None:
        self._file = file
        self._progress = progress
        self._size = os.fstat(file.fileno()).st_size

    def read(self, size: int = -1) -> bytes:
        """Return the next block and report the position."""
        block = self._file.read(size)
        if self._progress is not None:
            self._progress(self._file.tell(), self._size)
        return block

    def fileno(self) -> int:
        """Return the descriptor, from which httpx takes the length of the body."""
        return self._file.fileno()

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to a position; httpx rewinds before it sends."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the position in bytes."""
        return self._file.tell()
