"""A simulated GPU: all computation is on the CPU, but tensors have a device and mixing devices is an error.

It rejects what torch rejects with a real GPU: operations on tensors of different devices, numpy of a GPU tensor, and
the CPU generator for noise on the GPU. Gradients, speed and numerical differences of a GPU are not simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._device import _device_constructors
from torch.utils._pytree import tree_leaves

CPU, GPU = torch.device("cpu"), torch.device("cuda", 0)
# Functions that accept tensors on both devices: copying, and indexing a GPU tensor with a CPU index.
MIXED_DEVICE_FUNCTIONS = {"copy_", "__getitem__", "_has_compatible_shallow_copy_type"}


def device_of(tensor: Tensor) -> torch.device | None:
    """Device of a tensor; None if unknown."""
    return tensor.__dict__.get("put")


def put(found: Any, where: torch.device | None) -> Any:
    for each in tree_leaves(found):
        if isinstance(each, Tensor) and where is not None:
            each.put = where  # type: ignore[attr-defined]
    return found


def device_named(value: Any) -> torch.device | None:
    """Device given by an argument, or None."""
    if isinstance(value, Tensor):
        return device_of(value)
    if isinstance(value, str | torch.device) and str(value).split(":")[0] in ("cpu", "cuda"):
        return torch.device(str(value).split(":")[0], 0) if str(value).startswith("cuda") else CPU
    return None


class DeviceCheckMode(TorchFunctionMode):
    """Intercepts all torch functions and tracks the devices of inputs and outputs."""

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if function in SINGLE_TENSOR_FUNCTIONS:
            return SINGLE_TENSOR_FUNCTIONS[function](*args, *kwargs.values())
        asked = device_named(kwargs.pop("device", None))
        leaves = tree_leaves((args, kwargs))
        _refuse_mixed(getattr(function, "__name__", ""), args, leaves)
        everywhere = {device_of(each) for each in leaves if isinstance(each, Tensor)}
        where = asked or next((each for each in (GPU, CPU) if each in everywhere), None)
        if where is None and function in _device_constructors():
            where = CPU
        if where == GPU and any(isinstance(each, torch.Generator) for each in leaves):
            raise RuntimeError("expected a 'cuda' device type for generator, found 'cpu': pretended")
        found = function(*args, **kwargs)
        return found if found is None or any(found is each for each in leaves) else put(found, where)


def _refuse_mixed(name: str, args: Any, leaves: list[Any]) -> None:
    """Raise RuntimeError for tensors on different devices; zero-dimensional tensors may be on any device."""
    places = {device_of(each) for each in leaves if isinstance(each, Tensor) and each.dim()} - {None}
    if len(places) > 1 and (
        name not in MIXED_DEVICE_FUNCTIONS or (name == "__getitem__" and device_of(args[0]) == CPU)
    ):
        raise RuntimeError(f"{name}: expected all tensors to be on the same device, found cpu and cuda: pretended")


def _moved(tensor: Tensor, *asked: Any) -> Tensor:
    """`Tensor.to`: another device, another dtype, or both."""
    where = next((each for each in map(device_named, asked) if each), device_of(tensor))
    dtypes = [each.dtype if isinstance(each, Tensor) else each for each in asked]
    dtype = next((each for each in dtypes if isinstance(each, torch.dtype)), tensor.dtype)
    if where == device_of(tensor) and dtype == tensor.dtype:
        return tensor
    return put(tensor.to(dtype, copy=True), where)


def _set_data(tensor: Tensor, value: Tensor) -> None:
    tensor.data = value
    put(tensor, device_of(value))


def _numpy(tensor: Tensor, *asked: Any) -> Any:
    if device_of(tensor) == GPU:
        raise TypeError("can't convert cuda:0 device type tensor to numpy: pretended")
    return tensor.__array__(*asked)


# Functions of one tensor that return or change its device.
SINGLE_TENSOR_FUNCTIONS: dict[Any, Any] = {
    Tensor.device.__get__: lambda tensor: device_of(tensor) or CPU,
    Tensor.is_cuda.__get__: lambda tensor: device_of(tensor) == GPU,
    Tensor.grad.__get__: lambda tensor: put(tensor.grad, device_of(tensor)),
    Tensor.grad.__set__: lambda tensor, value: setattr(tensor, "grad", value),
    Tensor.data.__set__: _set_data,
    Tensor.to: _moved,
    Tensor.cpu: lambda tensor: _moved(tensor, CPU),
    Tensor.cuda: lambda tensor: _moved(tensor, GPU),
    Tensor.numpy: _numpy,
    Tensor.__array__: _numpy,
}


@contextmanager
def fake_gpu() -> Iterator[None]:
    """Context of a machine with one simulated GPU."""
    autocast, from_numpy, as_tensor = torch.autocast, torch.from_numpy, torch.as_tensor
    with pytest.MonkeyPatch.context() as patch, DeviceCheckMode():
        patch.setattr(torch.cuda, "is_available", lambda: True)
        patch.setattr(torch.cuda, "device_count", lambda: 1)
        patch.setattr(torch.cuda, "set_device", lambda index: None)
        patch.setattr(torch.backends.cudnn, "is_acceptable", lambda tensor: False)
        patch.setattr(torch, "use_deterministic_algorithms", lambda *args, **kwargs: None)
        patch.setattr(torch, "autocast", lambda device, *args, **kwargs: autocast("cpu", *args, **kwargs))
        patch.setattr(torch, "from_numpy", lambda array: put(from_numpy(array), CPU))
        patch.setattr(torch, "as_tensor", lambda *args, **kwargs: put(as_tensor(*args, **kwargs), CPU))
        yield
