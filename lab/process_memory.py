"""How much memory processes really take together, and which they are. Linux only."""

import contextlib
from collections import Counter

import psutil


def proportional_bytes(pid: int) -> int:
    """Return the proportional set size of one process: its own pages plus its share of the common ones.

    Raises psutil.Error when the process has ended or belongs to another user.
    """
    return int(psutil.Process(pid).memory_full_info().pss)


def family_bytes(pid: int) -> dict[str, int]:
    """Return the proportional bytes of `pid` and of everything below it, added up by command, the largest first."""
    found: Counter[str] = Counter()
    for member in [pid, *descendants(pid)]:
        with contextlib.suppress(psutil.Error):
            found[command_of(member)] += proportional_bytes(member)
    return dict(found.most_common())


def descendants(pid: int) -> list[int]:
    """Return the ids of all processes below `pid`, parents before children; none for one that has ended."""
    try:
        return [each.pid for each in psutil.Process(pid).children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def command_of(pid: int) -> str:
    """Return the command line of a process, its words between spaces, or the name that it took; empty when it has ended."""
    try:
        process = psutil.Process(pid)
        name = process.name()
        return name if name.startswith("panoloc-") else " ".join(process.cmdline())
    except psutil.Error:
        return ""
