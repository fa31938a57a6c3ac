"""Files on their way into the storage: each is written to the spool folder, hashed and checked while it arrives."""

import contextlib
import hashlib
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from panoloc.core.scan.format_detection import HEAD_BYTES, extension_of, format_of
from panoloc.service.errors import UploadTooLargeError
from panoloc.service.storage.disk import disk_errors

MAX_FIELD_BYTES = 64 * 1024


def check_scan_head(head: bytes, name: str) -> None:
    """Raise what `format_of` raises for a file that is no scan."""
    format_of(head, extension_of(name))


@dataclass(frozen=True)
class PartRule:
    """What parts of one name may be.

    max_bytes: of one part. setting: the name of that limit. spooled: written to a file. max_parts: how often it may
    come. max_full_parts: how many of them may have `max_bytes`; all together have no more bytes than these. check_head:
    raises for a spooled file with the first bytes, or the name, of an unwanted format.
    """

    max_bytes: int = MAX_FIELD_BYTES
    setting: str | None = None
    spooled: bool = False
    max_parts: int = 1
    max_full_parts: int = 1
    check_head: Callable[[bytes, str], object] = check_scan_head

    @property
    def max_total_bytes(self) -> int:
        """Return the bytes of all parts of this name together."""
        return self.max_bytes * self.max_full_parts

    def too_large(self, name: str, got: str = "more", together: bool = False) -> UploadTooLargeError:
        """Return the error for a part that is larger than allowed, or for parts of one name that are so together."""
        most, whose = self.max_bytes, ""
        limit = f" ({self.setting})" if self.setting else ""
        if together:
            most, whose = self.max_total_bytes, " in all parts of this name together"
            limit = f" ({self.max_full_parts} times {self.setting})" if self.setting else ""
        return UploadTooLargeError(
            f"{name}: expected at most {most:,} bytes{whose}{limit}, got {got}; send smaller files"
        )


@dataclass
class SpooledFile:
    """A file on its way into the storage. name: at the client; sha256: hexadecimal."""

    name: str
    path: Path
    num_bytes: int
    sha256: str


class Spool:
    """Writes a part to a file; bytes wait in memory until `write_out`, which may run in another thread."""

    def __init__(self, folder: Path, name: str, rule: PartRule, part: str) -> None:
        self._name, self._rule, self._part = name, rule, part
        self._path = folder / uuid.uuid4().hex
        with disk_errors():
            self._file: BinaryIO = self._path.open("wb")
        self._digest = hashlib.sha256()
        self._waiting = bytearray()
        self._num_bytes = 0
        self._head_checked = False

    @property
    def num_waiting(self) -> int:
        """Return how many bytes wait for `write_out`."""
        return len(self._waiting)

    def add(self, data: bytes) -> None:
        """Take more bytes. Raises UploadTooLargeError, and what `format_of` raises as soon as the head is there."""
        self._num_bytes += len(data)
        if self._num_bytes > self._rule.max_bytes:
            raise self._rule.too_large(self._part)
        self._waiting += data
        if not self._head_checked and self._num_bytes >= HEAD_BYTES:
            self._check_head()

    def write_out(self) -> None:
        """Write and hash what waits. Raises StorageFullError and StorageReadOnlyError."""
        self._digest.update(self._waiting)
        with disk_errors():
            self._file.write(self._waiting)
        self._waiting.clear()

    def finish(self) -> SpooledFile:
        """Close the file and return what is in it. Raises as `write_out` does."""
        if not self._head_checked:
            self._check_head()
        self.write_out()
        with disk_errors():
            # The last bytes leave the buffer only now.
            self._file.close()
        return SpooledFile(self._name, self._path, self._num_bytes, self._digest.hexdigest())

    def discard(self) -> None:
        """Remove the file."""
        with contextlib.suppress(OSError):  # of a full disk, once more
            self._file.close()
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)

    def _check_head(self) -> None:
        self._rule.check_head(bytes(self._waiting[:HEAD_BYTES]), self._name)
        self._head_checked = True
