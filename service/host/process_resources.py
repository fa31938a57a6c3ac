"""What this process takes of its machine: processors, of which a container has fewer than the machine, and what others
may want of them, and freed memory.

The C library's heap keeps what was freed unless it is told otherwise.
"""

import ctypes
import math
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path

# How long threads of torch that wait for each other spin before they sleep: OpenMP's own milliseconds starve everybody
# where other work wants the cores, and to sleep at once makes a query without kernels 1.7 times as long where none does.
SPINNING = {"GOMP_SPINCOUNT": "5000"}
_CGROUP_LIMIT = Path("/sys/fs/cgroup/cpu.max")
_CGROUP_MEMORY = Path("/sys/fs/cgroup/memory.max")
_GPUS = Path("/proc/driver/nvidia/gpus")
_PACKAGES = Path("/sys/devices/system/cpu")
# Numbers of <malloc.h>; 32 MB is the largest threshold that it takes.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_LARGEST_THRESHOLD, _KEPT_BYTES = 32 << 20, 512 << 20


def bound_spinning() -> None:
    """Let waiting threads of torch leave the processors to others soon, in this process and its children.

    Call it before torch is imported. What the user's environment says of it stays.
    """
    for name, value in SPINNING.items():
        os.environ.setdefault(name, value)


def num_usable_cpus(cgroup_limit: Path = _CGROUP_LIMIT) -> int:
    """Return the processors that this process may use: its affinity mask, and the container's quota rounded up."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = cgroup_limit.read_text().split()
    except (OSError, ValueError):
        return allowed
    return allowed if quota == "max" else max(1, min(allowed, math.ceil(int(quota) / int(period))))


def num_sockets(cpus: Path = _PACKAGES) -> int:
    """Return how many processor packages the machine has; 1 where it does not say."""
    packages = set()
    for topology in cpus.glob("cpu[0-9]*/topology/physical_package_id"):
        packages.add(topology.read_text().strip())
    return max(1, len(packages))


def visible_gpus() -> list[str]:
    """Return the CUDA devices that this process may use, as `CUDA_VISIBLE_DEVICES` names them; asks no library."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is not None:
        return [device for device in chosen.split(",") if device and device != "-1"]
    return [str(number) for number, _ in enumerate(_GPUS.glob("*"))]


def usable_memory_bytes() -> int:
    """Return the memory that this process may use: the machine's, or the container's limit."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        return min(machine, int(_CGROUP_MEMORY.read_text()))
    except (OSError, ValueError):  # no container, or "max"
        return machine


def limit_process(num_bytes: int, cpu_s: float) -> None:
    """Let this process allocate `num_bytes` and compute for `cpu_s` more than it has until now.

    Beyond the one Python raises MemoryError, beyond the other the kernel ends the process, whatever native code it is
    in. Linux only: elsewhere it does nothing.
    """
    if not sys.platform.startswith("linux"):
        return
    import resource

    # Of private writable memory, which is what grows; address space is reserved in gigabytes that nobody uses.
    lines = Path("/proc/self/status").read_text().splitlines()
    has_now = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmData:"))
    resource.setrlimit(resource.RLIMIT_DATA, (has_now + num_bytes, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    used = resource.getrusage(resource.RUSAGE_SELF)
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(used.ru_utime + used.ru_stime + cpu_s),) * 2)


def can_filter_system_calls() -> bool:
    """Tell whether the readers of scans will have their filter, see `panoloc.core.sandbox`."""
    try:
        knows_seccomp = "\nSeccomp:" in Path("/proc/self/status").read_text()
    except OSError:
        return False
    return knows_seccomp and platform.machine() in ("x86_64", "aarch64")


def keep_freed_memory() -> None:
    """Let the process keep what it frees for its next allocations, until `return_freed_memory`.

    By default every array of some size is mapped anew, and a tenth of a query is spent on the system handing out empty
    pages. Does nothing where the C library has no such call.
    """
    if (option := _c_function("mallopt")) is not None:
        option(_M_ARENA_MAX, 1)
        option(_M_MMAP_THRESHOLD, _LARGEST_THRESHOLD)
        option(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def return_freed_memory() -> None:
    """Give freed memory back to the system; 1 to 10 ms. Does nothing where the C library has no such call."""
    if (trim := _c_function("malloc_trim")) is not None:
        trim(0)


def _c_function(name: str) -> Callable[..., int] | None:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
