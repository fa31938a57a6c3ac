"""The memory and time of a sandboxed reader."""

import sys
from dataclasses import dataclass

_GRACE_S = 5


@dataclass(frozen=True)
class SandboxLimits:
    """memory_bytes: address space. cpu_s: processor time. silence_s: longest wait for the next message."""

    memory_bytes: int = 6 << 30
    cpu_s: int = 900
    silence_s: float = 300.0


def take_limits(limits: SandboxLimits) -> None:
    """Apply `limits` to this process; it also writes no files and no core dump. Does nothing on Windows."""
    if sys.platform == "win32":
        return
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
