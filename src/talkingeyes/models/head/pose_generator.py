"""What every generator of head poses is: speech, a start pose and a person's style in, poses of six numbers out.

These are the head generators that a model of the head alone is made of (`kind: speech_to_pose`), each one file here:
`mean`, `random`, `similar` (pose_baselines), `cnn`, `vae`, `vqvae`, `posegan`. A model of the head alone drives the
gaze decoder of any other model (`kind: head_then_gaze`). The generators of `generator.py`, of three numbers, are
trained together with a gaze decoder.

Poses are in units of the train split: centred, each number divided by its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import torch
from jaxtyping import Float
from pydantic import BeforeValidator, SerializeAsAny
from torch import Tensor

from talkingeyes.core.settings import ComponentRegistry, ComponentSettings

POSE_GENERATORS = ComponentRegistry(
    "generator of head poses",
    {
        "mean": "talkingeyes.models.head.pose_baselines:MeanPose",
        "random": "talkingeyes.models.head.pose_baselines:RandomPose",
        "similar": "talkingeyes.models.head.pose_baselines:SimilarPose",
        "cnn": "talkingeyes.models.head.pose_cnn:CNNPose",
        "vae": "talkingeyes.models.head.pose_vae:VAEPose",
        "vqvae": "talkingeyes.models.head.pose_vqvae:VQVAEPose",
        "posegan": "talkingeyes.models.head.posegan:PoseGAN",
    },
    ("set_training_windows", "predict", "sample"),
)
PoseComponentSettings = Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(POSE_GENERATORS.parse)]


@dataclass(frozen=True)
class PoseInputs:
    """What a generator hears: features that are learnt with it, the style in them and by itself, and the embedding."""

    features: Float[Tensor, "B T S"]
    style: Float[Tensor, "B S"]
    standardised: Float[Tensor, "B T H"]


@dataclass(frozen=True)
class TrainingWindows:
    """Training windows, for generators that draw from them: poses, and what their sound is like."""

    pose: Float[Tensor, "N L 6"]
    speech_statistics: Float[Tensor, "N D"]


@dataclass(frozen=True)
class PosePrediction:
    """Poses as the generator makes them of true ones and their speech, and the terms of its loss."""

    pose: Float[Tensor, "B T P"]
    loss_terms: dict[str, Tensor]


class PoseGenerator(Protocol):
    """The role: a torch module made as `Class(settings, speech, embedding)`, the widths of what it hears."""

    settings_class: Any
    # Frames that are made at once, each window starting at the last pose of the one before; None: any number.
    window: int | None

    def set_training_windows(self, training_windows: TrainingWindows) -> None:
        """Take what it draws from of the train split; most take nothing."""
        ...

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Named terms of the loss for true poses under their speech."""
        ...

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """Poses, a source of noise a row; a row is the same alone or with others."""
        ...


def mean_and_std(standardised: Float[Tensor, "B T H"]) -> Float[Tensor, "B D"]:
    """What nearest neighbours compare of a sound: means and standard deviations of its features."""
    return torch.cat([standardised.mean(1), standardised.std(1, correction=0)], dim=1)
