"""How many processors there are for us, which inside a container is not how many the machine has."""

import math
import os
from pathlib import Path

_CGROUP_LIMIT = Path("/sys/fs/cgroup/cpu.max")
_PACKAGES = Path("/sys/devices/system/cpu")


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
