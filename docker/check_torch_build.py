"""Stop the image's build when the installed PyTorch does not fit the device that the image is for.

Usage: check_torch_build.py cpu|cuda
"""

import importlib.metadata
import sys


def main(device: str) -> str | None:
    """Return what is wrong with this environment for `device`, or None."""
    if device not in ("cpu", "cuda"):
        return f"DEVICE: expected cpu or cuda, got {device!r}"
    from torch.version import cuda

    cuda_packages = [d.name for d in importlib.metadata.distributions() if d.name.lower().startswith("nvidia-")]
    if device == "cpu" and (cuda is not None or cuda_packages):
        return (
            f"DEVICE=cpu: expected a CPU build of PyTorch, got one for CUDA {cuda} with {len(cuda_packages)} nvidia- "
            "packages; pass a pip configuration that finds the CPU build (--secret id=pip_config,src=pip.conf)"
        )
    if device == "cuda" and cuda is None:
        return (
            "DEVICE=cuda: expected a CUDA build of PyTorch, got the CPU build; pass a pip configuration that finds it "
            "(--secret id=pip_config,src=pip.conf) or name it (--build-arg TORCH=...)"
        )
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else ""))
