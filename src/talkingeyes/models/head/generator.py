"""What every head generator is: it reconstructs true head motion in training and samples head motion for speech.

A generator is one file here: `vae` (the paper's), `causal_vae` (for streams), `vqvae` (Table V) or `events`;
docs/extend.md adds one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Protocol

from jaxtyping import Float
from pydantic import BeforeValidator, SerializeAsAny
from torch import Tensor

from talkingeyes.core.settings import ComponentRegistry, ComponentSettings
from talkingeyes.models.layers.normaliser import MotionNormaliser

HEAD_GENERATORS = ComponentRegistry(
    "head generator",
    {
        "vae": "talkingeyes.models.head.vae:VAEHead",
        "causal_vae": "talkingeyes.models.head.causal_vae:CausalVAEHead",
        "point_process": "talkingeyes.models.head.point_process:PointProcessHead",
        "vqvae": "talkingeyes.models.head.vqvae:VQVAEHead",
    },
    ("predict", "sample"),
)
HeadComponentSettings = Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(HEAD_GENERATORS.parse)]


@dataclass(frozen=True)
class HeadPrediction:
    """The head motion as the generator reconstructs it (radians), and the terms of the loss."""

    head: Float[Tensor, "B T 3"]
    loss_terms: dict[str, Tensor]


class HeadGenerator(Protocol):
    """The role: a torch module made as `Class(settings, speech)`, `speech` features a frame."""

    settings_class: Any

    @property
    def normal(self) -> MotionNormaliser:
        """Rotation vectors centred on the mean, in units of the scale: what the gaze generator sees of the head. It is
        set to the statistics of the train split, one scale for all three numbers."""
        ...

    def predict(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> HeadPrediction:
        """Named terms of the loss for true motion under its speech."""
        ...

    def sample(self, speech: Float[Tensor, "B T S"], seeds: list[int]) -> Float[Tensor, "B T 3"]:
        """Rotation vectors, a seed a row; a seed gives the same alone or with others."""
        ...
