"""Interface of pose generators: from speech, an initial pose and a speaker's style to head poses of six dimensions.

They are the generators of models of the head alone (`kind: speech_to_pose`), one file each: `mean`, `random`, `similar`
(pose_baselines), `cnn`, `vae`, `vqvae`, `posegan`. A model of the head alone drives the gaze decoder of any other model
(`kind: head_then_gaze`). The generators of `generator.py`, of three dimensions, are trained together with a gaze
decoder.

Poses are normalised by the train split: centred, and each dimension divided by its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Protocol, runtime_checkable

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
    ("predict", "sample"),
)
PoseComponentSettings = Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(POSE_GENERATORS.parse)]


@dataclass(frozen=True)
class PoseInputs:
    """Inputs of a generator: learned speech features with the style added, the style alone, and the standardised
    embedding."""

    features: Float[Tensor, "B T S"]
    style: Float[Tensor, "B S"]
    standardised: Float[Tensor, "B T H"]


@dataclass(frozen=True)
class PosePrediction:
    """Poses that the generator predicts from true poses and their speech, and its loss terms."""

    pose: Float[Tensor, "B T P"]
    loss_terms: dict[str, Tensor]


class PoseGenerator(Protocol):
    """Protocol of a torch module constructed as `Class(settings, speech, embedding)`, the input widths."""

    settings_class: Any
    # Frames generated at once, each window starting at the last pose of the one before; None: any number.
    window: int | None

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Prediction and named loss terms for true poses given their speech."""
        ...

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """Sample poses, one random generator per row. A row does not depend on the rest of the batch."""
        ...


@runtime_checkable
class RetrievingPoseGenerator(Protocol):
    """Further member of a generator that retrieves windows of the train split."""

    def set_training_windows(self, pose: Float[Tensor, "N L 6"], speech_features: Float[Tensor, "N D"]) -> None:
        """Store the windows and the means and deviations of their speech (`baselines.mean_and_std`)."""
        ...
