"""What a process that reads the files of strangers gives up for good before it does: memory, time, files, secrets and system calls."""

import ctypes
import errno
import os
import platform
import struct
import sys
from dataclasses import dataclass

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
_NEEDED = frozenset({"PATH", "HOME", "LANG", "TMPDIR", "LD_LIBRARY_PATH", "PROJ_DATA", "PROJ_LIB", "MALLOC_ARENA_MAX"})
_FAMILIES = ("LC_", "PYTHON")


@dataclass(frozen=True)
class SandboxLimits:
    """memory_bytes: address space. cpu_s: processor time. silence_s: longest wait for the next message."""

    memory_bytes: int = 6 << 30
    cpu_s: int = 900
    silence_s: float = 300.0


def sandbox_environment() -> dict[str, str]:
    """Return the environment of such a process: only what a reader needs, no passwords, no tokens."""
    kept = {name: text for name, text in os.environ.items() if name in _NEEDED or name.startswith(_FAMILIES)}
    path = os.pathsep.join(filter(None, sys.path))
    return {**kept, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": path}


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
