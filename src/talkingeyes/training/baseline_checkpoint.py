"""Baselines of head and gaze or of the face as checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from talkingeyes.core.settings import validate_section
from talkingeyes.models.baselines import BaselineSettings, MotionBank
from talkingeyes.training.checkpoint import Checkpoint, save


def save_baseline(
    folder: Path, settings: BaselineSettings, bank: MotionBank, more: Mapping[str, Any] | None = None
) -> None:
    """Write a baseline; `more`: further entries of its configuration."""
    tensors = {name: torch.from_numpy(np.asarray(value)) for name, value in vars(bank).items()}
    save(folder, tensors, {"model": settings.model_dump(mode="json"), **(more or {})})


def load_baseline(checkpoint: Checkpoint) -> tuple[BaselineSettings, MotionBank]:
    """Settings and bank of a checkpoint. Raises KeyError or InputError for other checkpoints."""
    bank = MotionBank(**{each.name: checkpoint.tensors[each.name].numpy() for each in fields(MotionBank)})
    return validate_section("model", BaselineSettings, checkpoint.config["model"]), bank
