"""Baselines of head and gaze or of the face, and lookups, as checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from talkingeyes.core.settings import validate_section
from talkingeyes.models.baselines import BaselineSettings, MotionBank
from talkingeyes.models.face.emotion_mean import EmotionMeans, EmotionMeanSettings
from talkingeyes.models.replay import ReplayBank, ReplaySettings
from talkingeyes.training.checkpoint import Checkpoint, save

AnyBank = TypeVar("AnyBank", MotionBank, ReplayBank, EmotionMeans)


def save_baseline(
    folder: Path,
    settings: BaselineSettings | ReplaySettings | EmotionMeanSettings,
    bank: MotionBank | ReplayBank | EmotionMeans,
    more: Mapping[str, Any] | None = None,
) -> None:
    """Write a baseline; `more`: further entries of its configuration."""
    tensors = {name: torch.from_numpy(np.asarray(value)) for name, value in vars(bank).items()}
    save(folder, tensors, {"model": settings.model_dump(mode="json"), **(more or {})})


def load_baseline(checkpoint: Checkpoint) -> tuple[BaselineSettings, MotionBank]:
    """Settings and bank of a checkpoint. Raises KeyError or InputError for other checkpoints."""
    return validate_section("model", BaselineSettings, checkpoint.config["model"]), _bank(checkpoint, MotionBank)


def load_replay(checkpoint: Checkpoint) -> tuple[ReplaySettings, ReplayBank]:
    """Settings and bank of a lookup. Raises KeyError or InputError for other checkpoints."""
    return validate_section("model", ReplaySettings, checkpoint.config["model"]), _bank(checkpoint, ReplayBank)


def load_emotion_means(checkpoint: Checkpoint) -> EmotionMeans:
    """Means of a checkpoint. Raises KeyError for other checkpoints."""
    return _bank(checkpoint, EmotionMeans)


def _bank(checkpoint: Checkpoint, kind: type[AnyBank]) -> AnyBank:
    return kind(**{each.name: checkpoint.tensors[each.name].numpy() for each in fields(kind)})
