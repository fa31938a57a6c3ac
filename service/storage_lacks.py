"""What a storage lacks that cannot be written now, told from what is a fault: a full disk and a folder without rights pass."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import StorageFullError, StorageReadOnlyError, TryAgainError

_RETRY_AFTER_S = 60
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_READ_ONLY = frozenset({errno.EROFS, errno.EACCES, errno.EPERM})


@contextmanager
def lacks_said() -> Iterator[None]:
    """Raise StorageFullError and StorageReadOnlyError in place of what the system raises for a full disk or a folder without rights."""
    try:
        yield
    except OSError as error:
        lack = _lack(error)
        if lack is None:
            raise
        raise lack from error


def _lack(error: OSError) -> TryAgainError | None:
    if error.errno in _FULL:
        return StorageFullError(
            "expected room in the data folder, but the disk is full; ask the operator for space", _RETRY_AFTER_S
        )
    if error.errno in _READ_ONLY:
        return StorageReadOnlyError(
            f"expected a data folder that can be written, but the system says: {os.strerror(error.errno)}; ask the operator",
            _RETRY_AFTER_S,
        )
    return None
