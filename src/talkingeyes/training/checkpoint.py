"""A trained network on disk: model.safetensors, config.json (its resolved configuration) and history.json."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn
from torch.nn.modules.module import (
    register_module_buffer_registration_hook,
    register_module_parameter_registration_hook,
)

from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError

AnyModule = TypeVar("AnyModule", bound=nn.Module)


@dataclass(frozen=True)
class Checkpoint:
    """Configuration and tensors of a network."""

    config: dict[str, Any]
    tensors: dict[str, Tensor]


def save(
    folder: Path, tensors: Mapping[str, Tensor], config: Mapping[str, Any], history: Sequence[Mapping[str, float]] = ()
) -> None:
    """Write the three files into an existing folder."""
    contiguous = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    (folder / "model.safetensors").write_bytes(safetensors.torch.save(contiguous))
    (folder / "config.json").write_text(json.dumps(config, indent=1, sort_keys=True))
    (folder / "history.json").write_text(json.dumps(list(history), indent=1))


def load(folder: Path) -> Checkpoint:
    """Read a checkpoint folder, in single precision. Raises InputError if a file is missing or damaged."""
    try:
        config = read_json(folder / "config.json", "JSON file")
        tensors = safetensors.torch.load_file(folder / "model.safetensors")
    except (OSError, ValueError, safetensors.SafetensorError) as error:
        raise InputError(f"{folder}: not a trained model ({error}); `make repro` trains one") from None
    return Checkpoint(
        config, {name: each.float() if each.dtype == torch.half else each for name, each in tensors.items()}
    )


def build_network(build: Callable[[], AnyModule], tensors: Mapping[str, Tensor]) -> AnyModule:
    """Build a network by its configuration, load its tensors and set it to evaluation.

    Raises ValueError or RuntimeError if tensors and layers differ. A configuration that names more or larger layers
    than there are tensors is refused at the first layer too many, before its memory is used.
    """
    with _bounded_by(tensors):
        network = build()
    network.load_state_dict(tensors)
    return network.eval()


@contextmanager
def _bounded_by(tensors: Mapping[str, Tensor]) -> Iterator[None]:
    """Raise ValueError once the networks built in the block hold far more tensors or numbers than given.

    torch.nn registers a layer's parameters before it initialises them, so their memory is not yet touched. The factor
    is for layers that replace parts of theirs while they are built.
    """
    count, size, factor = 0, 0, 4
    most_count, most_size = factor * len(tensors), factor * sum(tensor.numel() for tensor in tensors.values())

    def register(module: nn.Module, name: str, tensor: Tensor | None) -> None:
        nonlocal count, size
        count, size = count + (tensor is not None), size + (0 if tensor is None else tensor.numel())
        if count > most_count or size > most_size:
            raise ValueError(f"its configuration names a larger network than that of its {len(tensors)} tensors")

    hooks = [register_module_parameter_registration_hook(register), register_module_buffer_registration_hook(register)]
    try:
        yield
    finally:
        for hook in hooks:
            hook.remove()
