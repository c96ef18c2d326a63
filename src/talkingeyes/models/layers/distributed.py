"""Split one batch over several processes (torch DDP under torchrun), with the results of a single process.

Every process samples the same batch and the same noise and keeps its own rows of both. Batch statistics are computed
over all processes. Results differ from those of one process only by the order of floating-point sums. In a single
process, all functions return their input.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from jaxtyping import Float
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

T = TypeVar("T", bound=Any)  # a list or a tensor


def world_size() -> int:
    """Number of processes that share a batch."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def rank() -> int:
    """Index of this process."""
    return dist.get_rank() if world_size() > 1 else 0


def local_rows(rows: T) -> T:
    """This process's rows of a batch, whose size must be a multiple of the number of processes."""
    count = len(rows) // world_size()
    mine: T = rows[rank() * count : (rank() + 1) * count]
    return mine


@torch.no_grad()
def all_reduce_mean(value: Float[Tensor, "*N"]) -> Float[Tensor, "*N"]:
    """Mean over all processes, without gradient."""
    if world_size() == 1:
        return value
    total = value.detach().clone()
    dist.all_reduce(total)
    return total / world_size()


@torch.no_grad()
def all_gather_rows(rows: Float[Tensor, "M C"]) -> Float[Tensor, "N C"]:
    """Rows of all processes in batch order. The number of rows may differ between processes."""
    if world_size() == 1:
        return rows
    counts = [torch.zeros(1, dtype=torch.long, device=rows.device) for _ in range(world_size())]
    dist.all_gather(counts, torch.tensor([len(rows)], device=rows.device))
    longest = int(max(counts))
    padded = torch.cat([rows, rows.new_zeros(longest - len(rows), rows.shape[1])])
    parts = [torch.empty_like(padded) for _ in counts]
    dist.all_gather(parts, padded)
    return torch.cat([part[: int(count)] for part, count in zip(parts, counts, strict=True)])


class BatchNoiseMode(TorchDispatchMode):
    """Within this mode, per-row noise (dropout, latent samples) is sampled for the whole batch and cut to the local
    rows.

    Random numbers under `no_grad`, such as restarts of codes, are not per-row noise: all processes sample the same
    ones.
    """

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        draw = NOISE_HANDLERS.get(func) if world_size() > 1 and torch.is_grad_enabled() else None
        return draw(func, *args, **(kwargs or {})) if draw else func(*args, **(kwargs or {}))


def _like(func: Any, rows: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    own_rows: Tensor = local_rows(func(_whole(rows), *args, **kwargs))
    return own_rows


def _sized(func: Any, size: Sequence[int], *args: Any, **kwargs: Any) -> Tensor:
    own_rows: Tensor = local_rows(func([size[0] * world_size(), *size[1:]], *args, **kwargs))
    return own_rows


def _in_place(func: Any, rows: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    return rows.copy_(_like(func, rows, *args, **kwargs))


def _dropout(func: Any, rows: Tensor, *args: Any, **kwargs: Any) -> tuple[Tensor, Tensor]:
    factor, mask = (local_rows(each) for each in func(_whole(rows).fill_(1), *args, **kwargs))
    return rows * factor, mask


def _whole(rows: Tensor) -> Tensor:
    """An empty tensor for the whole batch with the memory layout of the rows: noise is sampled in memory order."""
    size = (len(rows) * world_size(), *rows.shape[1:])
    strides = rows.stride()
    outermost_first = sorted(range(rows.dim()), key=lambda axis: -strides[axis])
    return torch.empty_permuted(size, outermost_first, dtype=rows.dtype, device=rows.device)


NOISE_HANDLERS: dict[Any, Callable[..., Any]] = {
    torch.ops.aten.rand_like.default: _like,
    torch.ops.aten.randn_like.default: _like,
    torch.ops.aten.rand.default: _sized,
    torch.ops.aten.randn.default: _sized,
    torch.ops.aten.bernoulli_.float: _in_place,
    torch.ops.aten.native_dropout.default: _dropout,
}
