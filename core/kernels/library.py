"""The compiled kernels, called on tensors in memory. Where there are none, and on other devices, tensors do their work."""

import ctypes
import logging
import zlib
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Argument = Tensor | NDArray[Any] | float | None

_log = logging.getLogger(__name__)
BUILDS = {"AVX512": ("x86_64_v4", "x86_64_v3", "baseline"), "AVX2": ("x86_64_v3", "baseline")}


@lru_cache(maxsize=1)
def kernels() -> ctypes.CDLL | None:
    """Return the kernels for this processor; None, which is logged once, where none were built from these sources."""
    folder, found = Path(__file__).parent, "missing"
    checksum = zlib.crc32(b"".join(path.read_bytes() for path in sorted((*folder.glob("*.cpp"), *folder.glob("*.h")))))
    for build in BUILDS.get(torch.backends.cpu.get_cpu_capability(), ("baseline",)):
        for path in sorted(folder.glob(f"_{build}.*so")):
            try:
                library = loaded(path)
            except (OSError, AttributeError) as error:  # damaged, or built for another system
                found = f"unusable ({error})"
                continue
            if library.sources() == checksum:
                return library
            found = "older than their sources"
    _log.warning("the compiled kernels are %s: queries take several times as long; scripts/install builds them", found)
    return None


def loaded(path: Path) -> ctypes.CDLL:
    """Return the kernels of one build. Raises OSError or AttributeError for what is none."""
    library = ctypes.CDLL(str(path))
    for function in (library.first_distinct, library.threads, library.sources):
        function.restype = ctypes.c_int64
    return library


def kernels_name() -> str | None:
    """Return the name of the build of the kernels, such as `x86_64_v3`; None where there are none."""
    library = kernels()
    return None if library is None else Path(library._name).name.split(".")[0].removeprefix("_")


def use_threads(count: int) -> None:
    """Let `count` threads of this process compute, where it was one until now. Kernels share their work well; with tensors threads wait for
    each other after every operation, for long where something else runs: where there are kernels, one computes with them."""
    if has_kernels():
        call("set_threads", count)
    torch.set_num_threads(1 if has_kernels() else count)


def num_threads() -> int:
    """Return how many threads of this process compute."""
    return call("threads") if has_kernels() else torch.get_num_threads()


def has_kernels() -> bool:
    """Return whether there are kernels."""
    return kernels() is not None


def has_kernels_for(tensor: Tensor) -> bool:
    """Return whether there are kernels for numbers like those of a tensor: of single precision, in memory."""
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32 and has_kernels()


def call(name: str, *arguments: Argument) -> int:
    """Call a kernel, and return the whole number that it returns, which means nothing of most.

    It is given the addresses of tensors and arrays, null of None, whole numbers as int64 and others as float. Tensors are given as they lie
    in memory, one number after the other, so what is written to must lie so; their types are those that the kernel names.
    """
    held = [in_a_row(part) for part in arguments]
    return int(getattr(kernels(), name)(*map(as_c, held)))


def in_a_row(argument: Argument) -> Argument:
    """Return an argument whose numbers lie one after the other."""
    if isinstance(argument, Tensor):
        return argument.contiguous()
    return np.ascontiguousarray(argument) if isinstance(argument, np.ndarray) else argument


def as_c(argument: Argument) -> ctypes.c_void_p | ctypes.c_int64 | ctypes.c_float:
    """Return an argument of a kernel as C takes it."""
    if isinstance(argument, Tensor):
        assert argument.dtype not in (torch.float64, torch.int32), "no kernel has tensors of this type"
        return ctypes.c_void_p(argument.data_ptr())
    if isinstance(argument, np.ndarray):
        return ctypes.c_void_p(argument.ctypes.data)
    if isinstance(argument, float):
        return ctypes.c_float(argument)
    return ctypes.c_void_p(None) if argument is None else ctypes.c_int64(argument)
