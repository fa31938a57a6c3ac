"""Files in a folder: key `a/b` is the file `a/b` in it.

A write goes to a temporary file, which is synced and renamed; then its folder is synced. A file written with `put` or
`adopt` has its digest in a file beside it.
"""

import contextlib
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from panoloc.service.errors import StorageError, StoredFileChangedError
from panoloc.service.storage.disk import age_s, disk_errors, make_folder, sync_folder
from panoloc.service.storage.protocol import DIGEST_SUFFIX, Stamp, Storage, check_digest, missing, parts_of

_PROBE_BYTES = 4096
_DELETED = "deleted-"


@contextmanager
def _may_read(key: str) -> Iterator[None]:
    """Say of a file or folder that the service has no right to read which one it is."""
    try:
        yield
    except PermissionError as error:
        raise StorageError(
            f"{key!r}: expected what the service may read, but the system says: {error.strerror}; give it to the user of the service"
        ) from error


class FolderStorage(Storage):
    """Used by one or several processes; see `Storage`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._spool = folder / "uploads"

    def put(self, key: str, data: bytes) -> None:
        """Store bytes and their digest."""
        self._write_digest(key, hashlib.sha256(data).hexdigest())
        self.replace(key, data)

    def adopt(self, key: str, file: Path, digest: str) -> None:
        """Take over a file from the spool folder, or from anywhere on the same file system."""
        self._write_digest(key, digest)
        target = self._path(key)
        with disk_errors():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
            file.replace(target)
            sync_folder(target.parent)

    def replace(self, key: str, data: bytes, over: Stamp | None = None) -> Stamp:
        """Store bytes over older ones in one step; callers that pass `over` hold a lock that excludes other writers."""
        target = self._path(key)
        if over is not None and _stamp_of(target) != over:
            raise StoredFileChangedError(f"{key}: somebody else has replaced the file since it was read")
        with disk_errors():
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
                    temporary.unlink()
                raise
            sync_folder(target.parent)
            return _stamp(os.stat(target))

    def read_stamped(self, key: str) -> tuple[bytes, Stamp]:
        """Return the bytes, checked against their digest when there is one beside them, and their stamp."""
        try:
            with _may_read(key), self._path(key).open("rb") as file:
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
        try:
            yield path
        except FileNotFoundError as error:
            if path.exists():
                raise
            raise missing(key) from error  # deleted before the caller has opened it

    def names(self, prefix: str) -> list[str]:
        """Return the names directly below a prefix, sorted, without digests and unfinished files."""
        folder = self._path(prefix)
        with _may_read(prefix):
            found = os.listdir(folder) if folder.is_dir() else []
        return sorted(name for name in found if not name.startswith(".") and not name.endswith(DIGEST_SUFFIX))

    def delete_all(self, prefix: str) -> None:
        """Move the folder away in one step, then delete its files."""
        folder = self._path(prefix)
        # Beside `maps`, without a folder of its own: a full disk may have no room for one, and deleting makes room.
        condemned = self._folder / f"{_DELETED}{uuid.uuid4().hex}"
        try:
            with disk_errors():
                folder.rename(condemned)
                sync_folder(folder.parent)
        except FileNotFoundError:
            return
        shutil.rmtree(condemned, ignore_errors=True)

    def delete(self, key: str) -> None:
        """Delete a file, then its digest: without it the file would be read unchecked."""
        with disk_errors():
            for each in (key, key + DIGEST_SUFFIX):
                self._path(each).unlink(missing_ok=True)

    def spool_folder(self) -> Path:
        """Return the folder for uploads under way."""
        with disk_errors():
            self._spool.mkdir(parents=True, exist_ok=True)
        return self._spool

    def check_writable(self) -> None:
        """Write a few bytes into the spool folder, and remove them."""
        probe = self.spool_folder() / f"probe-{uuid.uuid4().hex}"
        try:
            with disk_errors():
                probe.write_bytes(bytes(_PROBE_BYTES))
        finally:
            with contextlib.suppress(OSError):
                probe.unlink()

    def tidy(self, min_age_s: float = 0.0) -> None:
        """Remove unfinished uploads, deletions and writes."""
        writes = (each for kept in ("maps", "batches", "changes") for each in (self._folder / kept).rglob(".*.tmp"))
        for leftover in (*self._spool.glob("*"), *self._folder.glob(f"{_DELETED}*"), *writes):
            if age_s(leftover) < min_age_s:
                continue
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)

    def stamps(self, prefix: str, name: str) -> dict[str, Stamp]:
        """Return the inode, modification time and size of the files of this name."""
        found = ((folder, _stamp_of(self._path(f"{prefix}/{folder}/{name}"))) for folder in self.names(prefix))
        return {folder: stamp for folder, stamp in found if stamp is not None}

    def _write_digest(self, key: str, digest: str) -> None:
        # Before the file itself: a file without a digest would be read unchecked.
        self.replace(key + DIGEST_SUFFIX, f"{digest}\n".encode())

    def _check(self, key: str, found: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            check_digest(key, self._path(key + DIGEST_SUFFIX).read_text("ascii").strip(), found)

    def _path(self, key: str) -> Path:
        return self._folder.joinpath(*parts_of(key))


def _stamp(file: os.stat_result) -> tuple[int, int, int]:
    return file.st_ino, file.st_mtime_ns, file.st_size


def _stamp_of(path: Path) -> Stamp | None:
    with contextlib.suppress(OSError):
        return _stamp(os.stat(path))
    return None
