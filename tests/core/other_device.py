"""A device that is not there: its tensors say that they lie on it, while their values lie in memory.

Where no GPU is, this shows what a GPU would stumble over: an operation on tensors of two devices, values taken without asking. It
also counts what costs time there, operations started and values asked for.
"""

from collections import Counter
from typing import Any

import torch
import torch.utils._pytree as pytree
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

# Of the types that PyTorch knows, the one that no code treats in a way of its own.
DEVICE = torch.device("meta")
_VIEWS = {"view", "_unsafe_view", "transpose", "t", "permute", "expand", "slice", "select", "unsqueeze", "squeeze"}
_VIEWS |= {
    "alias",
    "unbind",
    "detach",
    "split",
    "split_with_sizes",
    "diagonal",
    "_reshape_alias",
    "as_strided",
    "unfold",
}
# What cannot answer before everything before it is done.
_WAITING = {"_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_dim", "unique_consecutive", "equal"}


class FarTensor(torch.Tensor):
    """A tensor that says it lies on `DEVICE`; `near` has its values."""

    near: torch.Tensor

    @staticmethod
    def __new__(cls, near: torch.Tensor) -> "FarTensor":
        made = torch.Tensor._make_wrapper_subclass(
            cls, near.shape, strides=near.stride(), dtype=near.dtype, device=DEVICE
        )
        made.near = near
        return made

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:  # type: ignore[override]
        raise AssertionError(f"{function}: outside of `OtherDevice`")

    __torch_function__ = torch._C._disabled_torch_function_impl  # type: ignore[assignment]


class OtherDevice:
    """Within this context `DEVICE` exists. started: operations by name; asked: values fetched, by what fetched them."""

    def __init__(self) -> None:
        self.started: Counter[str] = Counter()
        self.asked: Counter[str] = Counter()
        self._modes = _Functions(self), _Operations(self)

    def __enter__(self) -> "OtherDevice":
        for mode in self._modes:
            mode.__enter__()  # type: ignore[no-untyped-call]
        return self

    def __exit__(self, *error: Any) -> None:
        for mode in reversed(self._modes):
            mode.__exit__(*error)  # type: ignore[no-untyped-call]


def _is_far(device: Any) -> bool:
    return device is not None and torch.device(device).type == DEVICE.type


class _Functions(TorchFunctionMode):
    """What moves values between the devices."""

    def __init__(self, owner: OtherDevice) -> None:
        super().__init__()
        self._owner = owner

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        name = getattr(function, "__name__", "")
        if function is torch.tensor and _is_far(kwargs.get("device")):
            self._owner.asked["upload"] += 1
            return FarTensor(torch.tensor(*args, **(kwargs | {"device": "cpu"})))
        if function is torch.Tensor.to:
            return self._moved(*args, **kwargs)
        if isinstance(args[0] if args else None, FarTensor):
            if name in ("cpu", "tolist"):
                self._owner.asked[name] += 1
                return args[0].near if name == "cpu" else args[0].near.tolist()
            assert name not in ("numpy", "__array__"), "an array of a tensor that lies on another device"
        return function(*args, **kwargs)

    def _moved(self, tensor: torch.Tensor, *targets: Any, **kwargs: Any) -> torch.Tensor:
        devices = [x.device if isinstance(x, torch.Tensor) else x for x in (*targets, *kwargs.values())]
        wanted = [x for x in devices if isinstance(x, str | torch.device)]
        types = [x.dtype if isinstance(x, torch.Tensor) else x for x in (*targets, *kwargs.values())]
        dtype = next((x for x in types if isinstance(x, torch.dtype)), tensor.dtype)
        far = _is_far(wanted[0]) if wanted else isinstance(tensor, FarTensor)
        if far == isinstance(tensor, FarTensor):
            return tensor.to(dtype) if dtype != tensor.dtype else tensor
        self._owner.asked["upload" if far else "download"] += 1
        values = tensor.near if isinstance(tensor, FarTensor) else tensor
        return FarTensor(values.to(dtype)) if far else values.to(dtype)


class _Operations(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Computes on the values, and says what no device would do."""

    def __init__(self, owner: OtherDevice) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._owner = owner

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        name = function._schema.name.split("::")[1]
        tensors = [x for x in pytree.tree_leaves((args, kwargs)) if isinstance(x, torch.Tensor)]
        far = any(isinstance(x, FarTensor) for x in tensors)
        near = [x for x in tensors if not isinstance(x, FarTensor) and x.dim() > 0]
        whole_numbers = all(not x.dtype.is_floating_point for x in near)  # indexing takes those from anywhere
        assert not (far and near) or (name.startswith("index") and whole_numbers), f"{name}: tensors of two devices"
        if "device" in kwargs and not name.startswith("new_"):
            far = _is_far(kwargs["device"]) or (far and kwargs["device"] is None)
        if "device" in kwargs:
            kwargs["device"] = torch.device("cpu")
        if far and name not in _VIEWS:
            self._owner.started[name] += 1
        if far and name in _WAITING:
            self._owner.asked[name] += 1
        values = pytree.tree_map(lambda x: x.near if isinstance(x, FarTensor) else x, (args, kwargs))
        result = function(*values[0], **values[1])
        if function._schema.is_mutable:
            return kwargs["out"] if "out" in kwargs else args[0]
        return pytree.tree_map(lambda x: FarTensor(x) if isinstance(x, torch.Tensor) else x, result) if far else result
