"""Takes secrets out of the environment of this process: out of what its children inherit, and out of what the system shows of it.

Linux shows other processes of the same user the environment that a process was started with (`/proc/…/environ`), whatever was unset since.
"""

import contextlib
import ctypes
import os
from collections.abc import Iterable, MutableMapping


def remove_variables(environment: MutableMapping[str, str], names: Iterable[str]) -> None:
    """Remove variables, of those of this process also the bytes that they were passed in."""
    for name in names:
        if environment is os.environ:
            _overwrite(name)
        environment.pop(name, None)


def _overwrite(name: str) -> None:
    with contextlib.suppress(OSError, AttributeError):  # a system without such a library shows nothing either
        libc = ctypes.CDLL(None)
        libc.getenv.restype = ctypes.c_void_p
        address = libc.getenv(os.fsencode(name))
        if address:
            ctypes.memset(address, ord("*"), len(ctypes.string_at(address)))
