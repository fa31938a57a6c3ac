"""Names of files: as people see them, and each once."""

from collections.abc import Iterable
from pathlib import PurePosixPath


def display_name(name: str) -> str:
    """Return the name of a file with its control characters, which steer terminals, written out: `\\x1b`.

    Bytes that are no UTF-8 stay as `os.fsdecode` has them.
    """
    return "".join(each if each.isprintable() or "\udc80" <= each <= "\udcff" else ascii(each)[1:-1] for each in name)


def distinct_names(given: Iterable[str]) -> list[str]:
    """Return a name for each one given, in its order: itself where it is free, else with `-2`, `-3` … before its ending.

    A name that is given once is never changed for the sake of one that comes earlier and has to be.
    """
    names = list(given)
    as_given = {_key(name) for name in names}
    taken: set[str] = set()
    found = []
    for name in names:
        path, number, free = PurePosixPath(name), 1, name
        while _key(free) in taken or (free != name and _key(free) in as_given):
            number += 1
            free = str(path.with_name(f"{path.stem}-{number}{path.suffix}"))
        taken.add(_key(free))
        found.append(free)
    return found


def _key(name: str) -> str:
    return name.casefold()
