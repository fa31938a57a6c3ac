"""Child processes: one that runs a module of this installation, and those that end when this process ends, however that happens."""

import asyncio
import sys
from collections.abc import Mapping, Sequence

# Behind the program a shell reads from the pipe until the kernel closes its other end. A parent-death signal would not
# do: it comes when the thread that started the child ends, and on Linux only.
_WATCH = 'exec 3<&0 </dev/null; (read -r _ <&3; kill -KILL $$) >/dev/null 2>&1 & exec 3<&-; exec "$@"'


def ending_with_parent(command: Sequence[str]) -> list[str]:
    """Return a command that runs `command` and ends it with SIGKILL when its standard input ends.

    Start it with a pipe as standard input, and close that pipe as soon as the program has ended.
    """
    return ["/bin/sh", "-c", _WATCH, "sh", *command]


async def run_module(
    module: str, *arguments: str, environment: Mapping[str, str] | None = None, time_s: float | None = None
) -> tuple[int, str]:
    """Run `python -m MODULE ARGUMENT...`; return its exit code and the last line of its messages.

    Whatever ends the waiting kills the process. environment: None for that of this process. Raises TimeoutError after
    `time_s`.
    """
    pipe, nothing = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
    command = (sys.executable, "-P", "-m", module, *arguments)
    process = await asyncio.create_subprocess_exec(*command, stderr=pipe, stdin=nothing, env=environment)
    try:
        async with asyncio.timeout(time_s):
            _, messages = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode is not None
    return process.returncode, (messages.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
