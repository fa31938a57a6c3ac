"""The C library's heap, which keeps what was freed."""

import ctypes
import sys

# Numbers of <malloc.h>; 32 MB is the largest threshold that it takes.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_LARGEST_THRESHOLD, _KEPT_BYTES = 32 << 20, 512 << 20


def keep_freed_memory() -> None:
    """Let the process keep what it frees for its next allocations, until `return_freed_memory`.

    By default every array of some size is mapped anew, and a tenth of a query is spent on the system handing out empty pages.
    Does nothing where the C library has no such call.
    """
    if not sys.platform.startswith("linux"):
        return
    option = getattr(ctypes.CDLL(None), "mallopt", None)
    if option is not None:
        option(_M_ARENA_MAX, 1)
        option(_M_MMAP_THRESHOLD, _LARGEST_THRESHOLD)
        option(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def return_freed_memory() -> None:
    """Give freed memory back to the system; 1 to 10 ms. Does nothing where the C library has no such call."""
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
