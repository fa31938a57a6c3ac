"""Folders whose entries survive a power cut, and disk errors translated into what a caller can do about them."""

import contextlib
import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from panoloc.service.errors import StorageFullError, StorageReadOnlyError

_RETRY_AFTER_S = 60
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_READ_ONLY = frozenset({errno.EROFS, errno.EACCES, errno.EPERM})


@contextmanager
def disk_errors() -> Iterator[None]:
    """Raise StorageFullError for a full disk and StorageReadOnlyError for missing rights; other OSErrors pass."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise StorageFullError(
                "expected room in the data folder, but the disk is full; ask the operator for space", _RETRY_AFTER_S
            ) from error
        if error.errno in _READ_ONLY:
            raise StorageReadOnlyError(
                f"expected a data folder that can be written, but the system says: {os.strerror(error.errno)}; "
                "ask the operator",
                _RETRY_AFTER_S,
            ) from error
        raise


def make_folder(folder: Path) -> None:
    """Make a folder and its parents, durably."""
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    sync_folder(folder.parent)


def sync_folder(folder: Path) -> None:
    """Make a rename in a folder survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def age_s(path: Path) -> float:
    """Return the seconds since a file was written or a folder's entries changed; 0 for what is gone."""
    with contextlib.suppress(OSError):
        return max(0.0, time.time() - path.stat().st_mtime)
    return 0.0
