"""One batch over several processes (torch DDP under torchrun): each computes its rows of the batch that one would draw.

So that several processes learn what one would: every process draws the same batch and the same noise and takes its own
rows of both, and what is counted over a batch is counted over all processes. What stays is the order of float sums.
In one process everything here gives back what it was given.
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
    """How many processes share a batch."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def rank() -> int:
    """Which of them this one is."""
    return dist.get_rank() if world_size() > 1 else 0


def local_rows(rows: T) -> T:
    """This process's rows of a batch (whose size is a multiple of the number of processes)."""
    count = len(rows) // world_size()
    mine: T = rows[rank() * count : (rank() + 1) * count]
    return mine


@torch.no_grad()
def all_reduce_mean(value: Float[Tensor, "*N"]) -> Float[Tensor, "*N"]:
    """The mean over all processes, without a gradient."""
    if world_size() == 1:
        return value
    total = value.detach().clone()
    dist.all_reduce(total)
    return total / world_size()


@torch.no_grad()
def all_gather_rows(rows: Float[Tensor, "M C"]) -> Float[Tensor, "N C"]:
    """The rows of all processes in the order of the batch; each may have another number of them."""
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
    """Within it, noise a row of the batch (dropout, draws of latent codes) is drawn for the whole batch and cut.

    Draws under `no_grad`, such as restarts of codes, are no noise of rows: all processes draw them alike.
    """

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        draw = NOISE_HANDLERS.get(func) if world_size() > 1 and torch.is_grad_enabled() else None
        return draw(func, *args, **(kwargs or {})) if draw else func(*args, **(kwargs or {}))


def _like(func: Any, rows: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    drawn: Tensor = local_rows(func(_whole(rows), *args, **kwargs))
    return drawn


def _sized(func: Any, size: Sequence[int], *args: Any, **kwargs: Any) -> Tensor:
    drawn: Tensor = local_rows(func([size[0] * world_size(), *size[1:]], *args, **kwargs))
    return drawn


def _in_place(func: Any, rows: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    return rows.copy_(_like(func, rows, *args, **kwargs))


def _dropout(func: Any, rows: Tensor, *args: Any, **kwargs: Any) -> tuple[Tensor, Tensor]:
    factor, mask = (local_rows(each) for each in func(_whole(rows).fill_(1), *args, **kwargs))
    return rows * factor, mask


def _whole(rows: Tensor) -> Tensor:
    """Room for the whole batch, laid out in memory as the rows are: noise is drawn in the order of memory."""
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
