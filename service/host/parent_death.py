"""Child processes that end when this process ends, however that happens."""

from collections.abc import Sequence

# Behind the program a shell reads from the pipe until the kernel closes its other end. A parent-death signal would not do: it comes when
# the thread that started the child ends, and on Linux only.
_WATCH = 'exec 3<&0 </dev/null; (read -r _ <&3; kill -KILL $$) >/dev/null 2>&1 & exec 3<&-; exec "$@"'


def ending_with_parent(command: Sequence[str]) -> list[str]:
    """Return a command that runs `command` and ends it with SIGKILL when its standard input ends.

    Start it with a pipe as standard input, and close that pipe as soon as the program has ended.
    """
    return ["/bin/sh", "-c", _WATCH, "sh", *command]
