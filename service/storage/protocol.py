"""What every storage does: `Storage` stands between the service and the folder or bucket that keeps its files.

Every write is atomic: after a crash at any moment a key holds either the old bytes or the new ones. What was written
with `put` or `adopt` is checked against its digest when it is read.
"""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from panoloc.service.errors import StoredFileDamagedError, StoredFileMissingError

DIGEST_SUFFIX = ".sha256"

Stamp = tuple[int, int, int] | str
"""Version of a stored file: differs after the file was replaced."""


class Storage(Protocol):
    """Keeps files by key. Blocking; safe for several threads and processes as long as one of them writes a key.

    Writes and deletes raise StorageFullError, StorageReadOnlyError and StorageAwayError, reads StorageAwayError.
    """

    def put(self, key: str, data: bytes) -> None:
        """Store bytes and their digest."""

    def adopt(self, key: str, file: Path, digest: str) -> None:
        """Take over a file (it is moved); digest: its SHA-256, hexadecimal."""

    def replace(self, key: str, data: bytes, over: Stamp | None = None) -> Stamp:
        """Store bytes that contain a digest of their own over older ones, in one step, and return their stamp.

        over: stamp of the bytes to replace; StoredFileChangedError where the key has others, or none. None: any.
        """

    def read(self, key: str) -> bytes:
        """Return the bytes. Raises StoredFileMissingError and StoredFileDamagedError."""
        return self.read_stamped(key)[0]

    def read_stamped(self, key: str) -> tuple[bytes, Stamp]:
        """Return the bytes as `read` does, with their stamp."""

    def local_copy(self, key: str, *, checked: bool = True) -> AbstractContextManager[Path]:
        """Give the path of a file with these bytes, to be read inside the `with` block only. Raises as `read` does.

        checked: against its digest, which reads the whole file.
        """

    def names(self, prefix: str) -> list[str]:
        """Return the names directly below a prefix such as `maps`, sorted; empty when there is none."""

    def delete_all(self, prefix: str) -> None:
        """Delete everything below a prefix, in one step for readers; does nothing when there is nothing.

        Files directly below the prefix, such as `map.json` and `batch.json`, are gone before all others.
        """

    def delete(self, key: str) -> None:
        """Delete one file with its digest; does nothing when there is none."""

    def spool_folder(self) -> Path:
        """Return a folder for uploads under way, from which `adopt` takes files."""

    def check_writable(self) -> None:
        """Raise StorageFullError, StorageReadOnlyError or StorageAwayError when nothing can be stored now."""

    def tidy(self, min_age_s: float = 0.0) -> None:
        """Remove what a crash has left behind; call it once, before anything is written.

        min_age_s: seconds since the last write to leftovers, where other processes use the storage as well.
        """

    def stamps(self, prefix: str, name: str) -> dict[str, Stamp]:
        """Return the stamp of the file of this name for each folder directly below a prefix that has one."""


def parts_of(key: str) -> list[str]:
    """Return the parts of a key. Raises StoredFileMissingError for a key that could lead out of the storage."""
    parts = key.split("/")
    if any(part in ("", ".", "..") or "\0" in part or "\\" in part for part in parts):
        raise StoredFileMissingError(f"{key!r}: expected a key such as maps/map_x/map.json")
    return parts


def missing(key: str) -> StoredFileMissingError:
    """Return the error for a file that is not there."""
    return StoredFileMissingError(
        f"{key}: expected a stored file, found none; check whether somebody changed the storage by hand"
    )


def check_digest(key: str, expected: str | None, found: str) -> None:
    """Raise StoredFileDamagedError where bytes differ from those that were stored. expected: None where unknown."""
    if expected is not None and found != expected:
        raise StoredFileDamagedError(
            f"{key}: expected the SHA-256 {expected[:12]}… recorded when it was stored, got {found[:12]}…; the file "
            "is damaged or was changed: restore it from a backup or upload the scan again"
        )
