"""The folder that holds sockets and logs of one running service, and the lock that keeps out others on the same data."""

import contextlib
import fcntl
import hashlib
import itertools
import os
import shutil
import stat
from pathlib import Path
from typing import IO

# Unix socket paths end at 107 bytes on Linux (103 on macOS) and Ray appends about 65 to its folder.
_LONGEST_RUN_PATH = 32


class DataFolderInUseError(RuntimeError):
    """Another service runs on the same data folder."""


class DataFolderUnusableError(OSError):
    """Nothing can be written to the data folder."""


class RunFolder:
    """`<data_dir>/run`, or a short stand-in under /tmp when that path is too long for sockets, or others use the data as well.

    Holds a lock on the data for as long as it is open, one for itself alone or one that allows others which share it; the kernel
    drops it when the process ends in any way.
    """

    def __init__(self, data_dir: Path, is_shared: bool = False) -> None:
        """Raise DataFolderInUseError when another service holds the folder, DataFolderUnusableError when it cannot be made, OSError when
        it cannot be written.

        is_shared: other services that say so too may use the data.
        """
        data_dir = data_dir.resolve()
        try:
            (data_dir / "run").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataFolderUnusableError(
                f"expected a data folder that can be made and written, got {data_dir} ({error.strerror}); correct PANOLOC_DATA_DIR"
            ) from error
        self._own = data_dir / "run"
        # What Ray makes in it is open to everybody; its sockets run code.
        self._own.chmod(0o700)
        self._lock = lock_folder(data_dir, is_shared)
        self._stand_in_lock: IO[str] | None = None
        try:
            if is_shared:
                self.path, self._stand_in_lock = _free_stand_in(data_dir)
            else:
                self.path = _short_folder(data_dir)
            _empty(self.path)
        except OSError:
            self._unlock()
            raise

    def close(self) -> None:
        """Remove what is left in the folder, and the folder itself where it is a stand-in, and let the next service in."""
        _empty(self.path)
        # One with a lock may be taken by another service at any time.
        if self.path != self._own and self._stand_in_lock is None:
            with contextlib.suppress(OSError):  # Ray may still write its last words
                self.path.rmdir()
        self._unlock()

    def _unlock(self) -> None:
        self._lock.close()
        if self._stand_in_lock is not None:
            self._stand_in_lock.close()


def lock_folder(folder: Path, is_shared: bool) -> IO[str]:
    """Return what keeps others out of a folder of files until it is closed, or those who do not share it. Raises DataFolderInUseError."""
    (folder / "run").mkdir(parents=True, exist_ok=True)
    path = folder / "run" / "lock"
    return _shared_lock(path) if is_shared else _sole_lock(path)


def _sole_lock(path: Path) -> IO[str]:
    lock = path.open("a+", encoding="ascii")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        lock.seek(0)
        holder = lock.read().strip() or "unknown"
        lock.close()
        raise DataFolderInUseError(
            f"{path.parent.parent}: expected a data folder of its own, but the service with process id {holder} is"
            " using it; stop that one, set PANOLOC_DATA_DIR, or PANOLOC_SHARED for each of them"
        ) from error
    lock.truncate(0)
    lock.write(f"{os.getpid()}\n")
    lock.flush()
    return lock


def _shared_lock(path: Path) -> IO[str]:
    lock = path.open("a+", encoding="ascii")
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        lock.close()
        raise DataFolderInUseError(
            f"{path.parent.parent}: expected a data folder that only services with PANOLOC_SHARED use, but one without it is using it; "
            "stop that one, or set PANOLOC_DATA_DIR"
        ) from error
    return lock


def _free_stand_in(data_dir: Path) -> tuple[Path, IO[str]]:
    """Return a folder of this machine's own, and the lock that keeps it ours: sockets on a disk of several machines lead nowhere."""
    for number in itertools.count():
        folder = _stand_in(data_dir, f"-{number}")
        lock = (folder / "lock").open("a+", encoding="ascii")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        return folder, lock
    raise AssertionError


def _short_folder(data_dir: Path) -> Path:
    folder = data_dir / "run"
    return folder if len(os.fsencode(folder)) <= _LONGEST_RUN_PATH else _stand_in(data_dir, "")


def _stand_in(data_dir: Path, suffix: str) -> Path:
    digest = hashlib.blake2b(os.fsencode(data_dir), digest_size=4).hexdigest()
    short = Path("/tmp") / f"panoloc-{digest}{suffix}"
    short.mkdir(mode=0o700, exist_ok=True)
    found = short.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise PermissionError(f"{short}: expected a folder of our own user, got one of user {found.st_uid}; remove it")
    short.chmod(0o700)
    return short


def _empty(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.name == "lock":
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)
