"""Names of files in lists that people look at."""


def shown_name(name: str) -> str:
    """Return the name of a file with its control characters, which steer terminals, written out: `\\x1b`.

    Bytes that are no UTF-8 stay as `os.fsdecode` has them.
    """
    return "".join(each if each.isprintable() or "\udc80" <= each <= "\udcff" else ascii(each)[1:-1] for each in name)
