"""What figures were measured on: the machine, and the versions of what computed. JSON-safe."""

import os
import platform
import sys
from importlib import metadata
from typing import Any

import numpy as np
import torch

from panoloc.core.kernels.library import kernels_name, num_threads


def machine() -> dict[str, Any]:
    """Return what the figures were measured on."""
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cpu_count": os.cpu_count(),
        "threads": num_threads(),
        "kernels": kernels_name(),
        "cuda_device": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
    }


def versions() -> dict[str, str]:
    """Return the versions that the figures depend on; panoloc is "not installed" where its files alone are there."""
    try:
        panoloc = metadata.version("panoloc")
    except metadata.PackageNotFoundError:
        panoloc = "not installed"
    return {
        "panoloc": panoloc,
        "python": sys.version.split()[0],
        "torch": str(torch.__version__),
        "numpy": np.__version__,
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()
