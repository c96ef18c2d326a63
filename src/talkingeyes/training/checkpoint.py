"""A trained network on disk: model.safetensors, config.json (its resolved configuration) and history.json."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError


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
    safetensors.torch.save_file(contiguous, folder / "model.safetensors")
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
