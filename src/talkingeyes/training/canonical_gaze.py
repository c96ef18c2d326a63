"""Gaze by canonical correlation, given the head of another trained model: fit, save and load.

The fit is in closed form, without training steps (models/gaze/canonical_correlation.py). The folder holds the fitted
regression and a copy of the model that generates the head.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.corpus.recordings import Normaliser, Recording
from talkingeyes.models.baselines import standardise
from talkingeyes.models.condition.conditioner import ConditioningInputs
from talkingeyes.models.gaze.canonical_correlation import (
    CanonicalCorrelation,
    CanonicalCorrelationSettings,
    Example,
    FeatureMap,
    fit_canonical_correlation,
    generate_gaze,
)
from talkingeyes.training.checkpoint import Checkpoint, save

HEAD_PREFIX = "head"


class CanonicalModelSettings(Settings):
    """The model that generates the head, and the settings of the canonical correlation."""

    kind: Literal["canonical_correlation"]
    parts: tuple[Literal["head", "gaze"], ...]
    tokenizer: None
    # The model that generates the head (any model with a head).
    source_models: tuple[str]
    gaze: CanonicalCorrelationSettings


@dataclass(frozen=True)
class CanonicalGaze:
    """Generates gaze for a speech embedding and a head."""

    settings: CanonicalCorrelationSettings
    correlation: CanonicalCorrelation
    mean: Float[ndarray, " C"]
    std: Float[ndarray, " C"]

    def generate_gaze(
        self,
        embedding: Float[ndarray, "T C"],
        head: Float[ndarray, "S T 3"],
        seeds: list[int],
        conditioning: ConditioningInputs,
    ) -> Float[ndarray, "S T 2 3"]:
        """One gaze motion per head motion; seeds differ only in the head."""
        standard = standardise(embedding, self.mean, self.std)
        return np.stack([generate_gaze(self.settings, self.correlation, standard, each) for each in head])


def fit_canonical_gaze(
    settings: CanonicalModelSettings, recordings: Sequence[Recording], normaliser: Normaliser, seed: int
) -> CanonicalGaze:
    """Fit the regression to the train split."""
    mean, std = normaliser.mean, normaliser.std
    examples = [Example(standardise(each.speech, mean, std), each.head, each.gaze) for each in recordings]
    return CanonicalGaze(settings.gaze, fit_canonical_correlation(settings.gaze, examples, seed), mean, std)


def save_canonical(
    folder: Path, settings: CanonicalModelSettings, correlation: CanonicalGaze, head: Checkpoint
) -> None:
    """Write the regression and the model of the head as one checkpoint."""
    arrays = {f"lift.{name}": value for name, value in asdict(correlation.correlation.feature_map).items()}
    arrays |= {name: getattr(correlation.correlation, name) for name in _own_arrays()} | {
        "mean": correlation.mean,
        "std": correlation.std,
    }
    tensors = {name: torch.from_numpy(np.asarray(value)) for name, value in arrays.items()}
    tensors |= {f"{HEAD_PREFIX}.{name}": tensor for name, tensor in head.tensors.items()}
    save(folder, tensors, {"model": settings.model_dump(mode="json"), HEAD_PREFIX: head.config})


def load_canonical(checkpoint: Checkpoint) -> CanonicalGaze:
    """Load the regression of a checkpoint; the model of the head is its part `head`."""
    arrays: dict[str, Any] = {name: tensor.numpy() for name, tensor in checkpoint.tensors.items()}
    feature_map = FeatureMap(**{each.name: arrays[f"lift.{each.name}"] for each in fields(FeatureMap)})
    correlation = CanonicalCorrelation(feature_map=feature_map, **{name: arrays[name] for name in _own_arrays()})
    settings = validate_section("model", CanonicalModelSettings, checkpoint.config["model"])
    return CanonicalGaze(settings.gaze, correlation, arrays["mean"], arrays["std"])


def _own_arrays() -> list[str]:
    return [each.name for each in fields(CanonicalCorrelation) if each.name != "feature_map"]
