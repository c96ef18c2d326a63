"""Gaze by canonical correlation behind the head of another trained model: found, kept and loaded.

Nothing is trained step by step (models/gaze/canonical.py has the closed form); the folder holds the relation and the
whole of the model that moves the head.
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

from talkingeyes.core.settings import Settings
from talkingeyes.corpus.windows import Normaliser, Recording
from talkingeyes.models.gaze.canonical import Canonical, CanonicalSettings, Example, Lift, look, relate
from talkingeyes.training.checkpoint import Checkpoint, save

HEAD = "head"


class CanonicalModelSettings(Settings):
    """The model: whose head it looks from, and how gaze is related."""

    kind: Literal["canonical"]
    parts: tuple[Literal["head", "gaze"], ...]
    prior: None
    # The model that moves the head (any that gives one).
    made_of: tuple[str]
    gaze: CanonicalSettings


@dataclass(frozen=True)
class CanonicalGaze:
    """Gaze for a speech embedding and a head."""

    settings: CanonicalSettings
    found: Canonical
    mean: Float[ndarray, " C"]
    std: Float[ndarray, " C"]

    def look(self, embedding: Float[ndarray, "T C"], head: Float[ndarray, "S T 3"]) -> Float[ndarray, "S T 2 3"]:
        """One gaze a head."""
        standard = _standard(embedding, self.mean, self.std)
        return np.stack([look(self.settings, self.found, standard, each) for each in head])


def find(
    settings: CanonicalModelSettings, recordings: Sequence[Recording], normaliser: Normaliser, seed: int
) -> CanonicalGaze:
    """The relation in the train split."""
    mean, std = normaliser.mean, normaliser.std
    examples = [Example(_standard(np.asarray(each.speech), mean, std), each.head, each.gaze) for each in recordings]
    return CanonicalGaze(settings.gaze, relate(settings.gaze, examples, seed), mean, std)


def save_canonical(folder: Path, settings: CanonicalModelSettings, found: CanonicalGaze, head: Checkpoint) -> None:
    """Write the relation and the head's model as one checkpoint."""
    arrays = {f"lift.{name}": value for name, value in asdict(found.found.lift).items()}
    arrays |= {name: getattr(found.found, name) for name in _own_arrays()} | {"mean": found.mean, "std": found.std}
    tensors = {name: torch.from_numpy(np.asarray(value)) for name, value in arrays.items()}
    tensors |= {f"{HEAD}.{name}": tensor for name, tensor in head.tensors.items()}
    save(folder, tensors, {"model": settings.model_dump(mode="json"), HEAD: head.config})


def load_canonical(checkpoint: Checkpoint) -> CanonicalGaze:
    """The relation in a checkpoint; the model of the head is its part `head`."""
    arrays: dict[str, Any] = {name: tensor.numpy() for name, tensor in checkpoint.tensors.items()}
    lift = Lift(**{each.name: arrays[f"lift.{each.name}"] for each in fields(Lift)})
    found = Canonical(lift=lift, **{name: arrays[name] for name in _own_arrays()})
    settings = CanonicalModelSettings.model_validate(checkpoint.config["model"])
    return CanonicalGaze(settings.gaze, found, arrays["mean"], arrays["std"])


def _own_arrays() -> list[str]:
    return [each.name for each in fields(Canonical) if each.name != "lift"]


def _standard(
    embedding: Float[ndarray, "T C"], mean: Float[ndarray, " C"], std: Float[ndarray, " C"]
) -> Float[ndarray, "T C"]:
    return np.asarray((embedding - mean) / np.maximum(std, 1e-6))
