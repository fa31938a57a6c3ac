"""How much memory processes really take together. Linux only: reads /proc."""

import contextlib
from collections import Counter
from pathlib import Path

from panoloc.service.host.process_tree import command_of, descendants


def proportional_bytes(pid: int) -> int:
    """Return the proportional set size of one process: its own pages plus its share of the common ones.

    Raises OSError when the process has ended or belongs to another user.
    """
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) * 1024
    raise OSError(f"/proc/{pid}/smaps_rollup: no line with Pss")


def family_bytes(pid: int) -> dict[str, int]:
    """Return the proportional bytes of `pid` and of everything below it, added up by command, the largest first."""
    found: Counter[str] = Counter()
    for member in [pid, *descendants(pid)]:
        with contextlib.suppress(OSError):
            found[command_of(member)] += proportional_bytes(member)
    return dict(found.most_common())
