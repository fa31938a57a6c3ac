"""The process of a sandboxed reader: `python -m panoloc.core.scan.sandbox.child`, started by `read_in_sandbox`.

It gives up memory, time, files and system calls for good before it reads.
"""

import ctypes
import dataclasses
import errno
import importlib
import json
import os
import platform
import struct
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from numpy.typing import NDArray

from panoloc.core.errors import ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext

_LONGEST_MESSAGE = 2000
_GRACE_S = 5
_SET_NO_NEW_PRIVS, _SET_SECCOMP, _FILTER_MODE = 38, 22, 2
_LOAD, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
_ALLOW, _KILL, _REFUSE = 0x7FFF0000, 0x80000000, 0x00050000 | errno.EPERM
_NUMBER_AT, _ARCHITECTURE_AT = 0, 4
# Numbers from here on are those of x32, which would be others for the same calls.
_X32 = 0x40000000

_X86_64 = {
    "socket": 41, "connect": 42, "execve": 59, "kill": 62, "ptrace": 101, "rt_sigqueueinfo": 129, "mount": 165, "unshare": 272,
    "perf_event_open": 298, "setns": 308, "process_vm_readv": 310, "process_vm_writev": 311, "bpf": 321, "execveat": 322,
    "userfaultfd": 323, "pidfd_send_signal": 424, "io_uring_setup": 425,
}  # fmt: skip
_AARCH64 = {
    "mount": 40, "unshare": 97, "ptrace": 117, "kill": 129, "rt_sigqueueinfo": 138, "socket": 198, "connect": 203, "execve": 221,
    "perf_event_open": 241, "setns": 268, "process_vm_readv": 270, "process_vm_writev": 271, "bpf": 280, "execveat": 281,
    "userfaultfd": 282, "pidfd_send_signal": 424, "io_uring_setup": 425,
}  # fmt: skip
# AUDIT_ARCH_… of <linux/audit.h>, and the numbers that calls have there.
_MACHINES = {"x86_64": (0xC000003E, _X86_64), "aarch64": (0xC00000B7, _AARCH64)}


@dataclass(frozen=True)
class SandboxLimits:
    """memory_bytes: address space. cpu_s: processor time. silence_s: longest wait for the next message."""

    memory_bytes: int = 6 << 30
    cpu_s: int = 900
    silence_s: float = 300.0


def main() -> None:
    """Read the scan that the argument describes as JSON, and send its points to standard output."""
    job: dict[str, Any] = json.loads(sys.argv[1])
    # Whatever a library prints must not get between the messages.
    stream = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    take_limits(SandboxLimits(**job["limits"]))
    refuse_system_calls()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        _read(job, stream)
    except ScanError as error:
        _send(stream, "error", error=type(error).__name__, message=str(error)[:_LONGEST_MESSAGE])
    except (MemoryError, RecursionError) as error:
        _send(stream, "error", error=type(error).__name__, message="")
    except Exception as error:
        _send(stream, "error", error="Exception", message=f"{type(error).__name__}: {error}"[:200])


def _end_with_parent() -> None:
    """Watch the parent: standard input ends when it dies, however it dies."""
    while os.read(0, 1):
        pass
    os._exit(1)


def _read(job: dict[str, Any], stream: BinaryIO) -> None:
    from panoloc.core.scan.reading import READERS

    path, folder = Path(job["path"]), job["folder"] and Path(job["folder"])
    context = ReadingContext(path, ScanOptions(**job["options"]), path.stat().st_size, folder=folder)
    module, _, name = job["reader"].rpartition(":")
    reader = getattr(importlib.import_module(module), name) if module else READERS[name]
    for chunk in reader(context):
        _send_chunk(stream, chunk)
    for found in context.diagnostics:
        _send(stream, "note", **dataclasses.asdict(found))
    _send(stream, "end", coordinate_system=context.coordinate_system)


def _send(stream: BinaryIO, kind: str, *arrays: NDArray[Any], **fields: Any) -> None:
    """Write a message: a line of JSON, then the arrays of a chunk as raw bytes. Nothing of it is executed."""
    stream.write(json.dumps({"kind": kind, **fields}).encode() + b"\n")
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def _send_chunk(stream: BinaryIO, chunk: RawChunk) -> None:
    """Write a chunk in pieces of at most CHUNK_ROWS rows."""
    color_type = chunk.colors.dtype.newbyteorder("<")
    for start in range(0, len(chunk.positions), CHUNK_ROWS):
        positions = chunk.positions[start : start + CHUNK_ROWS].astype("<f8", copy=False)
        colors = chunk.colors[start : start + CHUNK_ROWS].astype(color_type, copy=False)
        fields = {"rows": len(positions), "colors": color_type.str, "fraction": float(chunk.fraction)}
        _send(stream, "chunk", positions, colors, **fields)


def take_limits(limits: SandboxLimits) -> None:
    """Apply `limits` to this process; it also writes no files and no core dump."""
    import resource

    wanted = {
        resource.RLIMIT_AS: limits.memory_bytes,
        resource.RLIMIT_CPU: limits.cpu_s,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_FSIZE: 0,
    }
    for kind, most in wanted.items():
        hard = resource.getrlimit(kind)[1]
        allowed = most if hard == resource.RLIM_INFINITY else min(most, hard)
        # Of two equal limits of time the hard one is met first, which kills without telling why.
        is_time = kind == resource.RLIMIT_CPU and hard == resource.RLIM_INFINITY
        resource.setrlimit(kind, (allowed, allowed + _GRACE_S if is_time else allowed))


def refuse_system_calls() -> bool:
    """Make network, other programs and other processes fail with EPERM in this thread and all that it starts.

    Returns whether the system took the filter: False on other systems than Linux, on other processors than x86-64 and
    ARM64, and where the kernel has no seccomp.
    """
    machine = _MACHINES.get(platform.machine())
    if not sys.platform.startswith("linux") or machine is None:
        return False
    program = _program(*machine)
    code = ctypes.create_string_buffer(program, len(program))
    # struct sock_fprog: how many instructions, and where they are.
    header = struct.pack("H6xP", len(program) // 8, ctypes.addressof(code))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        return False
    return bool(libc.prctl(_SET_SECCOMP, _FILTER_MODE, header, 0, 0) == 0)


def _program(architecture: int, calls: dict[str, int]) -> bytes:
    numbers = sorted(calls.values())
    tests = [(_AT_LEAST, len(numbers) + 1, 0, _X32)]
    # Jumps count the instructions between: the rest of the tests, and the one that allows.
    tests += [(_EQUAL, len(numbers) - place, 0, number) for place, number in enumerate(numbers)]
    instructions = [
        (_LOAD, 0, 0, _ARCHITECTURE_AT), (_EQUAL, 1, 0, architecture), (_RETURN, 0, 0, _KILL), (_LOAD, 0, 0, _NUMBER_AT),
        *tests, (_RETURN, 0, 0, _ALLOW), (_RETURN, 0, 0, _REFUSE),
    ]  # fmt: skip
    return b"".join(struct.pack("HBBI", *each) for each in instructions)


if __name__ == "__main__":
    main()
