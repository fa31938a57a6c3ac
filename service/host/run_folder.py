"""The lock that keeps other services out of the same data, and the folder for sockets and logs of a running service."""

import fcntl
import os
import shutil
import tempfile
from pathlib import Path
from typing import IO

# The path of a Unix socket ends at 107 bytes on Linux, at 103 on macOS; the folder holds `redis.sock`.
_LONGEST_RUN_PATH = 90
_PRIVATE = 0o700


class DataFolderInUseError(RuntimeError):
    """Another service runs on the same data folder."""


class RunFolder:
    """`<data_dir>/run`, or a temporary folder when that path is too long for sockets.

    Holds a lock on the data for as long as it is open: an exclusive one, or one that allows others which share the
    data. The kernel drops it when the process ends in any way. Only its user can read a data folder that is made here.
    """

    def __init__(self, data_dir: Path, is_shared: bool = False) -> None:
        """Raise DataFolderInUseError when another service holds the folder, OSError when it cannot be made or written.

        is_shared: other services with the same setting may use the data; they have a Redis elsewhere and put nothing
        into the folder.
        """
        data_dir = data_dir.resolve()
        own = data_dir / "run"
        try:
            data_dir.mkdir(_PRIVATE, parents=True, exist_ok=True)
            own.mkdir(exist_ok=True)
        except OSError as error:
            raise OSError(
                f"expected a data folder that can be created and written, got {data_dir} ({error.strerror}); correct "
                "PANOLOC_DATA_DIR"
            ) from error
        own.chmod(_PRIVATE)
        self._lock = lock_folder(data_dir, is_shared)
        self._is_temporary = len(os.fsencode(own)) > _LONGEST_RUN_PATH
        self.path = Path(tempfile.mkdtemp(prefix="panoloc-")) if self._is_temporary else own
        if not is_shared:
            _empty(self.path)

    def close(self) -> None:
        """Remove what is in a temporary folder, and let the next service in."""
        if self._is_temporary:
            shutil.rmtree(self.path, ignore_errors=True)
        self._lock.close()


def lock_folder(folder: Path, is_shared: bool) -> IO[str]:
    """Return what keeps others out of a folder of files until it is closed, or those who do not share it.

    Raises DataFolderInUseError.
    """
    folder.mkdir(_PRIVATE, parents=True, exist_ok=True)
    (folder / "run").mkdir(exist_ok=True)
    lock = (folder / "run" / "lock").open("a+", encoding="ascii")
    try:
        fcntl.flock(lock, (fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError as error:
        lock.seek(0)
        holder = lock.read().strip() or "unknown"
        lock.close()
        raise DataFolderInUseError(
            f"{folder}: expected an unused data folder, but the service with process id {holder} is using it; stop that "
            "one, set another PANOLOC_DATA_DIR, or set PANOLOC_SHARED for both services"
        ) from error
    if not is_shared:
        lock.truncate(0)
        lock.write(f"{os.getpid()}\n")
        lock.flush()
    return lock


def _empty(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.name == "lock":
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)
