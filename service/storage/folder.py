"""Files in a folder: key `a/b` is the file `a/b` in it.

A write goes to a temporary file, which is synced and renamed, and its folder is synced. Beside each file written with `put` or `adopt`
lies its digest.
"""

import contextlib
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.durable_folders import age_s, make_folder, sync_folder
from service.errors import StoredFileChangedError
from service.storage.protocol import DIGEST_SUFFIX, Stamp, check_digest, missing, parts_of
from service.storage_lacks import lacks_said

_PROBE_BYTES = 4096


class FolderStorage:
    """Implements `Storage`."""

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

    def replace(self, key: str, data: bytes, over: Stamp | None = None) -> Stamp:
        """Store bytes over older ones in one step; whoever names what is replaced holds a lock that keeps others out meanwhile."""
        target = self._path(key)
        if over is not None and _stamp_of(target) != over:
            raise StoredFileChangedError(f"{key}: somebody else has replaced it since it was read")
        with lacks_said():
            self._write(target, data)
            return _stamp(os.stat(target))

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
        return self.read_stamped(key)[0]

    def read_stamped(self, key: str) -> tuple[bytes, Stamp]:
        """Return the bytes as `read` does, and the stamp of just these."""
        try:
            with self._path(key).open("rb") as file:
                stamp, data = _stamp(os.fstat(file.fileno())), file.read()
        except FileNotFoundError as error:
            raise missing(key) from error
        self._check(key, hashlib.sha256(data).hexdigest())
        return data, stamp

    @contextmanager
    def local_copy(self, key: str, *, checked: bool = True) -> Iterator[Path]:
        """Give the path of the file itself."""
        path = self._path(key)
        try:
            with path.open("rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest() if checked else None
        except FileNotFoundError as error:
            raise missing(key) from error
        if digest is not None:
            self._check(key, digest)
        yield path

    def names(self, prefix: str) -> list[str]:
        """Return the names directly below a prefix, sorted, without digests and unfinished files."""
        folder = self._path(prefix)
        if not folder.is_dir():
            return []
        found = (entry.name for entry in folder.iterdir())
        return sorted(name for name in found if not name.startswith(".") and not name.endswith(DIGEST_SUFFIX))

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
            for each in (key, key + DIGEST_SUFFIX):
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
                found[folder] = _stamp(os.stat(self._path(f"{prefix}/{folder}/{name}")))
        return found

    def _has_trash(self) -> bool:
        with contextlib.suppress(OSError):
            self._trash.mkdir(parents=True, exist_ok=True)
        return self._trash.is_dir()

    def _write_digest(self, key: str, digest: str) -> None:
        # Before the file itself: a file without a digest would be read unchecked.
        self.replace(key + DIGEST_SUFFIX, f"{digest}\n".encode())

    def _check(self, key: str, found: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            expected = self._path(key + DIGEST_SUFFIX).read_text("ascii").strip()
            check_digest(key, expected, found)

    def _path(self, key: str) -> Path:
        return self._folder.joinpath(*parts_of(key))


def _stamp(file: os.stat_result) -> Stamp:
    return file.st_ino, file.st_mtime_ns, file.st_size


def _stamp_of(path: Path) -> Stamp | None:
    with contextlib.suppress(FileNotFoundError):
        return _stamp(os.stat(path))
    return None
