"""A trained network on disk, read without torch (written by training/checkpoint.py)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.models.layers.numpy_layers import Tensors

MAX_FRAMES = 1000


@dataclass(frozen=True)
class NumpyCheckpoint:
    """Configuration and tensors of a network."""

    config: dict[str, Any]
    tensors: Tensors


def load_checkpoint(folder: Path) -> NumpyCheckpoint:
    """Read a checkpoint folder, in single precision. Raises InputError if a file is missing or damaged."""
    try:
        config = read_json(folder / "config.json", "JSON file")
        tensors = safetensors.numpy.load_file(folder / "model.safetensors")
    except (OSError, ValueError, safetensors.SafetensorError) as error:
        raise InputError(f"{folder}: not a trained model ({error}); `make repro` trains one") from None
    return NumpyCheckpoint(
        config, {name: each.astype(np.float32) if each.dtype == np.half else each for name, each in tensors.items()}
    )


def bounded(frames: Any) -> int:
    """A number of frames of a configuration. Raises ValueError if it is not a whole number of a plausible size."""
    if not isinstance(frames, int) or not 1 <= frames <= MAX_FRAMES:
        raise ValueError(f"a number of frames should be 1 to {MAX_FRAMES}, got {frames!r}")
    return frames
