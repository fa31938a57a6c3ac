"""Kernels for GPUs: compiled when they are first called, by the compiler that comes with PyTorch for CUDA (NVRTC)."""

import ctypes
import logging
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor

from panoloc.core.kernels.library import Argument, as_c, in_a_row

_FOLDER = Path(__file__).parent
_log = logging.getLogger(__name__)


def has_cuda_kernel(name: str, tensor: Tensor) -> bool:
    """Return whether there is a kernel for numbers like those of a tensor: of single precision, on a GPU."""
    return tensor.device.type == "cuda" and tensor.dtype == torch.float32 and _kernel(name, tensor.device) is not None


def launch(name: str, blocks: int, threads: int, *arguments: Argument) -> None:
    """Start `blocks` blocks of a kernel, of `threads` threads each, on the current stream of the first argument's device.

    Arguments are given as by `panoloc.core.kernels.library.call`; tensors must lie on that device.
    """
    device = next(part.device for part in arguments if isinstance(part, Tensor))
    rows = [in_a_row(part) for part in arguments]
    held = [as_c(part) for part in rows]
    addresses = (ctypes.c_void_p * len(held))(*(ctypes.addressof(each) for each in held))
    stream = ctypes.c_void_p(torch.cuda.current_stream(device).cuda_stream)
    _check(_driver().cuLaunchKernel(_kernel(name, device), blocks, 1, 1, threads, 1, 1, 0, stream, addresses, None))


@lru_cache
def _kernel(name: str, device: torch.device) -> ctypes.c_void_p | None:
    """Return a kernel as a device takes it; None, which is logged, where it cannot be compiled."""
    try:
        module, kernel = ctypes.c_void_p(), ctypes.c_void_p()
        _check(
            _driver().cuModuleLoadData(ctypes.byref(module), _compiled(name, torch.cuda.get_device_capability(device)))
        )
        _check(_driver().cuModuleGetFunction(ctypes.byref(kernel), module, name.encode()))
    except (OSError, RuntimeError) as error:
        _log.warning("the kernel %s cannot be used on this GPU: queries take several times as long (%s)", name, error)
        return None
    return kernel


def _compiled(name: str, capability: tuple[int, int]) -> bytes:
    """Return the machine code of a kernel, whose file has its name, for GPUs of a compute capability.

    Raises OSError where there is no compiler, RuntimeError for what it refuses.
    """
    compiler, program, size = _compiler(), ctypes.c_void_p(), ctypes.c_size_t()
    source = (_FOLDER / f"{name}.cu").read_bytes()
    options = [b"--gpu-architecture=sm_%d%d" % capability, b"--std=c++17", b"--include-path=" + str(_FOLDER).encode()]
    compiler.nvrtcCreateProgram(ctypes.byref(program), source, f"{name}.cu".encode(), 0, None, None)
    refused = compiler.nvrtcCompileProgram(program, len(options), (ctypes.c_char_p * len(options))(*options))
    asked = (compiler.nvrtcGetProgramLogSize, compiler.nvrtcGetProgramLog)
    ask_size, ask = asked if refused else (compiler.nvrtcGetCUBINSize, compiler.nvrtcGetCUBIN)
    ask_size(program, ctypes.byref(size))
    said = ctypes.create_string_buffer(size.value)
    ask(program, said)
    compiler.nvrtcDestroyProgram(ctypes.byref(program))
    if refused:
        raise RuntimeError(said.value.decode(errors="replace"))
    return said.raw


def _check(error: int) -> None:
    """Raise RuntimeError for an error of the driver."""
    if error:
        raise RuntimeError(f"CUDA error {error}")


@lru_cache
def _driver() -> ctypes.CDLL:
    return ctypes.CDLL("libcuda.so.1")


@lru_cache
def _compiler() -> ctypes.CDLL:
    """Return the compiler, which PyTorch knows where to find."""
    ctypes.CDLL(str(Path(torch.__file__).parent / "lib/libcaffe2_nvrtc.so"))
    return ctypes.CDLL(f"libnvrtc.so.{str(torch.version.cuda).partition('.')[0]}")
