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


def process_name(pid: int) -> str:
    """Return the name of the program, or what a Ray worker calls itself. Raises OSError when the process is gone."""
    words = Path(f"/proc/{pid}/cmdline").read_text(errors="replace").split("\0")
    # Ray renames its workers to "ray::Something" in the first word.
    return words[0].strip() if words[0].startswith("ray::") else Path(words[0]).name


def _children_by_parent() -> defaultdict[int, list[int]]:
    children: defaultdict[int, list[int]] = defaultdict(list)
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            # The name in parentheses may itself hold spaces and parentheses; the parent is the second word after it.
            parent = int(status.read_text().rpartition(")")[2].split()[1])
            children[parent].append(int(status.parent.name))
    return children
