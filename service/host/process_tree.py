"""The processes below one process. Linux only: reads /proc."""

import contextlib
from collections import defaultdict
from pathlib import Path


def descendants(pid: int) -> list[int]:
    """Return the ids of all processes below `pid`, parents before children."""
    children = _children_by_parent()
    found: list[int] = []
    waiting = [pid]
    while waiting:
        below = children[waiting.pop(0)]
        found += below
        waiting += below
    return found


def command_of(pid: int) -> str:
    """Return the command line of a process, its words between spaces; empty when the process is gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text(errors="replace").replace("\0", " ").strip()
    except OSError:
        return ""


def _children_by_parent() -> defaultdict[int, list[int]]:
    children: defaultdict[int, list[int]] = defaultdict(list)
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            # The name in parentheses may itself hold spaces and parentheses; the parent is the second word after it.
            parent = int(status.read_text().rpartition(")")[2].split()[1])
            children[parent].append(int(status.parent.name))
    return children
