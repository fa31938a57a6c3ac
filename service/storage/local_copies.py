"""Files of a bucket on the disk of this machine: a bounded cache that all its processes share.

Whoever uses a copy holds a lock on it, which the kernel drops when the process ends in whatever way. Only copies that
nobody holds are removed.
"""

import contextlib
import fcntl
import os
import uuid
from collections.abc import Callable
from io import BufferedIOBase
from pathlib import Path

from panoloc.service.storage.disk import disk_errors

_UNFINISHED = "."


class LocalCopies:
    """Blocking; of any thread. max_bytes: of the copies that are kept; 0: none stays after its use."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes

    def path(self, name: str) -> Path:
        """Return where a copy lies while it is held."""
        return self._folder / name

    def hold(self, name: str, fetch: Callable[[BufferedIOBase], None], *, anew: bool = False) -> BufferedIOBase:
        """Return the open copy of a file; it stays until `release`.

        name: identifies the bytes. fetch: writes them where there is no copy; its errors pass through.
        anew: also where there is one, as it is damaged.
        """
        path = self.path(name)
        while True:
            if not anew and (copy := _locked(path, "rb")) is not None:
                os.utime(path)
                return copy
            if (copy := self._fetched(path, fetch, anew)) is not None:
                return copy

    def release(self, copy: BufferedIOBase) -> None:
        """Close a copy, and remove the least recently used ones that are too many."""
        copy.close()
        with contextlib.suppress(OSError):
            self._make_room()

    def _fetched(self, path: Path, fetch: Callable[[BufferedIOBase], None], anew: bool) -> BufferedIOBase | None:
        """Fetch a copy and return it held; None where another process was faster, or took it for a dead one's."""
        with disk_errors():
            self._folder.mkdir(parents=True, exist_ok=True)
            unfinished = self._folder / f"{_UNFINISHED}{uuid.uuid4().hex}"
            if (copy := _locked(unfinished, "x+b")) is None:
                return None
            try:
                fetch(copy)
                copy.flush()
                copy.seek(0)
                if not anew:
                    try:
                        os.link(unfinished, path)
                        return copy
                    except FileExistsError:
                        copy.close()
                        return None
                    except OSError:  # a file system without links
                        pass
                unfinished.replace(path)
                return copy
            except BaseException:
                copy.close()
                raise
            finally:
                unfinished.unlink(missing_ok=True)

    def _make_room(self) -> None:
        found = [(path.stat(), path) for path in self._folder.iterdir()]
        num_bytes = sum(stat.st_size for stat, _ in found if stat.st_size <= self._max_bytes)
        for stat, path in sorted(found, key=lambda each: each[0].st_mtime_ns):
            is_too_large = stat.st_size > self._max_bytes
            if is_too_large or num_bytes > self._max_bytes or path.name.startswith(_UNFINISHED):
                with path.open("rb") as copy, contextlib.suppress(BlockingIOError):
                    fcntl.flock(copy, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    path.unlink(missing_ok=True)
                    num_bytes -= 0 if is_too_large else stat.st_size


def _locked(path: Path, mode: str) -> BufferedIOBase | None:
    """Open a file that nobody removes while it is open; None where there is none."""
    with contextlib.suppress(FileNotFoundError):
        # Not inherited by child processes, which would hold it after us.
        copy: BufferedIOBase = path.open(mode)  # type: ignore[assignment]
        fcntl.flock(copy, fcntl.LOCK_SH)
        if os.fstat(copy.fileno()).st_nlink:
            return copy
        copy.close()  # removed between our opening and our locking
    return None
