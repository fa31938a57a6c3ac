"""Where scans and map records live: files under keys such as `maps/map_x/1/scan.ply`.

`Storage` is the seam; `FolderStorage` keeps the files in a folder. Every write is atomic (temporary file, fsync,
rename, fsync of the folder): after a crash at any moment a key holds either the old bytes or the new ones. Beside each
file written with `put` or `adopt` lies its digest, which is checked when the file is read.
"""

import contextlib
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Protocol

from service.durable_folders import age_s, make_folder, sync_folder
from service.errors import StoredFileDamagedError, StoredFileMissingError
from service.storage_lacks import lacks_said

_DIGEST_SUFFIX = ".sha256"
_PROBE_BYTES = 4096

Stamp = tuple[int, int, int]


class Storage(Protocol):
    """Keeps files by key. Blocking; safe for several threads and processes as long as one of them writes a key.

    What writes or deletes raises StorageFullError and StorageReadOnlyError.
    """

    def put(self, key: str, data: bytes) -> None:
        """Store bytes and their digest."""

    def adopt(self, key: str, file: Path, digest: str) -> None:
        """Take over a file (it is moved); digest: its SHA-256, hexadecimal."""

    def replace(self, key: str, data: bytes) -> None:
        """Store bytes over older ones in one step, without a digest beside them: they have to bear their own."""

    def read(self, key: str) -> bytes:
        """Return the bytes. Raises StoredFileMissingError and StoredFileDamagedError."""

    def local_copy(self, key: str, *, checked: bool = True) -> AbstractContextManager[Path]:
        """Give the path of a file with these bytes, to be read only inside the `with` block. Raises as `read` does.

        checked: against its digest, which reads all of it.
        """

    def names(self, prefix: str) -> list[str]:
        """Return the names directly below a prefix such as `maps`, sorted; empty when there is none."""

    def delete_all(self, prefix: str) -> None:
        """Delete everything below a prefix, in one step for whoever reads; does nothing when there is nothing."""

    def delete(self, key: str) -> None:
        """Delete one file with its digest; does nothing when there is none."""

    def spool_folder(self) -> Path:
        """Return a folder for uploads under way, from which `adopt` takes files without copying them."""

    def check_writable(self) -> None:
        """Raise StorageFullError or StorageReadOnlyError when nothing can be stored now."""

    def tidy(self, min_age_s: float = 0.0) -> None:
        """Remove what a crash has left behind; call it once, before anything is written.

        min_age_s: seconds for which nobody may have written it, where other processes use the storage as well.
        """

    def stamps(self, prefix: str, name: str) -> dict[str, Stamp]:
        """Return what differs after a file of this name was replaced, for each folder directly below a prefix that has one."""


def open_storage(url: str) -> Storage:
    """Return the storage behind a path or a `file://` URL. Raises ValueError for any other scheme."""
    scheme, separator, path = url.partition("://")
    if not separator:
        return FolderStorage(Path(url))
    if scheme != "file":
        raise ValueError(f"storage: expected a folder or a file:// URL, got {scheme}://; set PANOLOC_DATA_DIR")
    return FolderStorage(Path(path))


class FolderStorage:
    """Implements `Storage` with a folder; key `a/b` is the file `a/b` in it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._trash = folder / "trash"
        self._spool = folder / "uploads"

    def put(self, key: str, data: bytes) -> None:
        """Store bytes and their digest."""
        self._write_digest(key, hashlib.sha256(data).hexdigest())
        self.replace(key, data)

    def adopt(self, key: str, file: Path, digest: str) -> None:
        """Take over a file from the spool folder, or from anywhere on the same file system."""
        self._write_digest(key, digest)
        target = self._path(key)
        with lacks_said():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
            file.replace(target)
            sync_folder(target.parent)

    def replace(self, key: str, data: bytes) -> None:
        """Store bytes over older ones in one step."""
        target = self._path(key)
        with lacks_said():
            self._write(target, data)

    def _write(self, target: Path, data: bytes) -> None:
        make_folder(target.parent)
        temporary = target.with_name(f".{target.name}.{uuid.uuid4().hex}.tmp")
        try:
            with temporary.open("wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        sync_folder(target.parent)

    def read(self, key: str) -> bytes:
        """Return the bytes, checked against their digest when there is one beside them."""
        try:
            data = self._path(key).read_bytes()
        except FileNotFoundError as error:
            raise _missing(key) from error
        self._check(key, hashlib.sha256(data).hexdigest())
        return data

    @contextmanager
    def local_copy(self, key: str, *, checked: bool = True) -> Iterator[Path]:
        """Give the path of the file itself."""
        path = self._path(key)
        try:
            with path.open("rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest() if checked else None
        except FileNotFoundError as error:
            raise _missing(key) from error
        if digest is not None:
            self._check(key, digest)
        yield path

    def names(self, prefix: str) -> list[str]:
        """Return the names directly below a prefix, sorted, without digests and unfinished files."""
        folder = self._path(prefix)
        if not folder.is_dir():
            return []
        found = (entry.name for entry in folder.iterdir())
        return sorted(name for name in found if not name.startswith(".") and not name.endswith(_DIGEST_SUFFIX))

    def delete_all(self, prefix: str) -> None:
        """Move the folder away in one step, then delete its files."""
        folder = self._path(prefix)
        # In the data folder itself where the disk has no room for another folder: deleting makes room.
        condemned = (self._trash if self._has_trash() else self._folder) / f"deleted-{uuid.uuid4().hex}"
        try:
            with lacks_said():
                folder.rename(condemned)
                sync_folder(folder.parent)
        except FileNotFoundError:
            return
        shutil.rmtree(condemned, ignore_errors=True)

    def delete(self, key: str) -> None:
        """Delete a file, then its digest: without it the file would be read unchecked."""
        with lacks_said():
            for each in (key, key + _DIGEST_SUFFIX):
                self._path(each).unlink(missing_ok=True)

    def spool_folder(self) -> Path:
        """Return the folder for uploads under way."""
        with lacks_said():
            self._spool.mkdir(parents=True, exist_ok=True)
        return self._spool

    def check_writable(self) -> None:
        """Write a few bytes into the spool folder, and remove them."""
        probe = self.spool_folder() / f"probe-{uuid.uuid4().hex}"
        try:
            with lacks_said():
                probe.write_bytes(bytes(_PROBE_BYTES))
        finally:
            with contextlib.suppress(OSError):
                probe.unlink(missing_ok=True)

    def tidy(self, min_age_s: float = 0.0) -> None:
        """Remove unfinished uploads, deletions and writes."""
        if min_age_s:
            uploads, deletions = [*self._spool.glob("*")], [*self._trash.glob("*")]
        else:
            uploads, deletions = [self._spool], [self._trash]
        deletions += self._folder.glob("deleted-*")
        writes = (each for kept in ("maps", "batches") for each in (self._folder / kept).rglob(".*.tmp"))
        for leftover in (*deletions, *uploads, *writes):
            if age_s(leftover) < min_age_s:
                continue
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)

    def stamps(self, prefix: str, name: str) -> dict[str, Stamp]:
        """Return number, time and size of the files of this name."""
        found: dict[str, Stamp] = {}
        for folder in self.names(prefix):
            with contextlib.suppress(OSError):
                file = os.stat(self._path(f"{prefix}/{folder}/{name}"))
                found[folder] = (file.st_ino, file.st_mtime_ns, file.st_size)
        return found

    def _has_trash(self) -> bool:
        with contextlib.suppress(OSError):
            self._trash.mkdir(parents=True, exist_ok=True)
        return self._trash.is_dir()

    def _write_digest(self, key: str, digest: str) -> None:
        # Before the file itself: a file without a digest would be read unchecked.
        self.replace(key + _DIGEST_SUFFIX, f"{digest}\n".encode())

    def _check(self, key: str, found: str) -> None:
        try:
            expected = self._path(key + _DIGEST_SUFFIX).read_text("ascii").strip()
        except FileNotFoundError:
            return
        if found != expected:
            raise StoredFileDamagedError(
                f"{key}: expected the SHA-256 {expected[:12]}… noted when it was stored, got {found[:12]}…; "
                "the disk or somebody changed it: restore it from a backup or upload the scan again"
            )

    def _path(self, key: str) -> Path:
        parts = key.split("/")
        if any(part in ("", ".", "..") or "\0" in part or "\\" in part for part in parts):
            raise StoredFileMissingError(f"{key!r}: expected a key such as maps/map_x/map.json")
        return self._folder.joinpath(*parts)


def _missing(key: str) -> StoredFileMissingError:
    return StoredFileMissingError(f"{key}: expected a stored file, found none; was the data folder changed by hand?")
