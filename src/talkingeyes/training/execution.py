"""Execution context of a training: device, precision, and the processes of torchrun, if any.

`machine=gpu` (conf/machine/gpu.yaml) selects a GPU. `torchrun --nproc-per-node 2 -m pipelines.train talkingeyes` splits
every batch between two processes, of which the first writes the results.
"""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from talkingeyes.core.errors import InputError
from talkingeyes.models.layers import distributed

LossFunction = Callable[[int], dict[str, Tensor]]


@dataclass(frozen=True)
class ExecutionContext:
    """A device and a precision. With `bfloat16`, losses are computed under autocast; weights stay float32."""

    device: torch.device
    precision: str

    @classmethod
    def of(cls, machine: Mapping[str, Any]) -> ExecutionContext:
        """The context of a `machine` section; under torchrun, this process joins the process group.

        Raises InputError (one line) if the device does not exist.
        """
        for key in ("device", "precision"):
            if key not in machine:
                raise InputError(f"params: machine.{key} is missing; `make params` writes it from conf/")
        index = int(os.environ.get("LOCAL_RANK", "0"))
        if machine["device"] == "cuda":
            _prepare_gpu(index)
        if "WORLD_SIZE" in os.environ and not dist.is_initialized():
            dist.init_process_group("nccl" if machine["device"] == "cuda" else "gloo")
            atexit.register(dist.destroy_process_group)
        device = torch.device("cuda", index) if machine["device"] == "cuda" else torch.device("cpu")
        return cls(device, str(machine["precision"]))

    @classmethod
    def single_process(cls, machine: Mapping[str, Any]) -> ExecutionContext:
        """The context of a training that cannot be distributed, because its losses compare all rows of a batch."""
        if int(os.environ.get("WORLD_SIZE", "1")) > 1:
            raise InputError(f"torchrun: should start a single process for this stage, got {os.environ['WORLD_SIZE']}")
        return cls.of(machine)

    @property
    def is_main(self) -> bool:
        """Whether this process writes the results."""
        return distributed.rank() == 0

    def exit_unless_main(self) -> None:
        """Exit all processes but the one that writes, after the work is done."""
        if not self.is_main:
            sys.exit(0)

    def describe(self) -> dict[str, Any]:
        """The properties that rounding differences of results depend on."""
        return {"device": self.device.type, "precision": self.precision, "world_size": distributed.world_size()}

    def autocast(self) -> AbstractContextManager[Any]:
        """Context manager for the precision of the losses."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.precision == "bfloat16")

    def distribute(self, module: nn.Module, losses: LossFunction, batch: int) -> LossFunction:
        """Losses of this process's rows of a batch; gradients are averaged over all processes."""
        if distributed.world_size() == 1:
            return losses
        if batch % distributed.world_size():
            raise InputError(
                f"loop.batch: should be a multiple of the {distributed.world_size()} processes, got {batch}"
            )
        return DistributedDataParallel(
            _DistributedLosses(module, losses), forward_sync_buffers=False, find_unused_parameters=True
        )


CPU_CONTEXT = ExecutionContext(torch.device("cpu"), "float32")


class _DistributedLosses(nn.Module):
    """Wraps the module and its losses in one forward for DDP; terms that are only reported are detached."""

    def __init__(self, module: nn.Module, losses: LossFunction) -> None:
        super().__init__()
        self.module, self.losses = module, losses

    def forward(self, step: int) -> dict[str, Tensor]:
        with distributed.BatchNoiseMode():
            losses = self.losses(step)
        return {name: value if name == "total" else value.detach() for name, value in losses.items()}


def _prepare_gpu(index: int) -> None:
    """Select a GPU and enable deterministic algorithms. Raises InputError if there is no GPU of this index."""
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if index >= count:
        raise InputError(
            f"machine.device: should be cpu or have {index + 1} GPU(s) usable by torch, got cuda with {count}"
        )
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.use_deterministic_algorithms(True, warn_only=True)
    torch.cuda.set_device(index)
