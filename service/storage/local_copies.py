"""Files of a bucket on the disk of this machine: a bounded cache that all its processes share.

A process links what it uses into a folder of its own, which it holds by a lock that the kernel drops when it ends, in whatever way:
others may remove what is not used, and what was left by the dead, and never pull a file away from under anybody.
"""

import contextlib
import fcntl
import os
import shutil
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from service.storage_lacks import lacks_said

_LOCK = "lock"
_OWN = "in-use-"


class LocalCopies:
    """Blocking; of any thread. max_bytes: of the files that nobody uses now; 0: none is kept."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes
        self._own: Path | None = None
        self._turn = threading.Lock()

    @contextmanager
    def use(self, name: str, suffix: str, fetch: Callable[[Path], None]) -> Iterator[Path]:
        """Give a path that ends in `suffix`, for the duration of a block.

        name: says what is in the file. fetch: writes it to a path, where there is no copy; what it raises goes through.
        """
        path = self._own_folder() / f"{uuid.uuid4().hex}{suffix}"
        try:
            if not self._take(name, path):
                with lacks_said():
                    fetch(path)
                self._keep(name, path)
            yield path
        finally:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)

    def forget(self, name: str) -> None:
        """Keep a copy no longer, as one that is damaged."""
        with contextlib.suppress(OSError):
            (self._folder / name).unlink()

    def _take(self, name: str, path: Path) -> bool:
        try:
            os.link(self._folder / name, path)
            os.utime(path)  # the copy's as well: they are one file
        except OSError:
            return False
        return True

    def _keep(self, name: str, path: Path) -> None:
        with self._turn, contextlib.suppress(OSError):  # a file system without links keeps none
            if path.stat().st_size <= self._max_bytes:
                with contextlib.suppress(FileExistsError):
                    os.link(path, self._folder / name)
                self._make_room()

    def _make_room(self) -> None:
        """Remove the copies that were used longest ago."""
        copies = [(path.stat(), path) for path in self._folder.iterdir() if not path.name.startswith(_OWN)]
        num_bytes = sum(found.st_size for found, _ in copies)
        for found, path in sorted(copies, key=lambda copy: copy[0].st_mtime_ns):
            if num_bytes <= self._max_bytes:
                return
            path.unlink(missing_ok=True)
            num_bytes -= found.st_size

    def _own_folder(self) -> Path:
        with self._turn, lacks_said():
            if self._own is None or not self._own.is_dir():
                self._folder.mkdir(parents=True, exist_ok=True)
                self._remove_those_of_the_dead()
                self._own = self._made_own()
            return self._own

    def _made_own(self) -> Path:
        while True:
            own = self._folder / f"{_OWN}{os.getpid()}-{uuid.uuid4().hex}"
            own.mkdir()
            # Taken for one of the dead, and removed, as long as nobody holds its lock.
            with contextlib.suppress(FileNotFoundError):
                # Open for as long as this process lives, and not in those that it starts.
                lock = os.open(own / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
                fcntl.flock(lock, fcntl.LOCK_EX)
                if (own / _LOCK).exists():
                    return own
                os.close(lock)

    def _remove_those_of_the_dead(self) -> None:
        for folder in self._folder.glob(f"{_OWN}*"):
            with contextlib.suppress(OSError):
                lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder, ignore_errors=True)
                finally:
                    os.close(lock)
