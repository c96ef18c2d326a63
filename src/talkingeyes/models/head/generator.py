"""Interface of head generators: they reconstruct true head motion in training and sample head motion from speech.

Each generator is one file of this folder: `vae` (the paper's), `causal_vae` (for streaming), `vqvae` (Table V) or
`point_process`. docs/extend.md explains how to add one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Protocol, runtime_checkable

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
    """Head motion as the generator reconstructs it (radians), and the loss terms."""

    head: Float[Tensor, "B T 3"]
    loss_terms: dict[str, Tensor]


class HeadGenerator(Protocol):
    """Protocol of a torch module `Class(settings, speech)`; `speech` is the number of features per frame."""

    settings_class: Any

    @property
    def normal(self) -> MotionNormaliser:
        """Normaliser of rotation vectors; its output is the head input of the gaze generator. It is set to the
        statistics of the train split, with one scale for all three dimensions."""
        ...

    def predict(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> HeadPrediction:
        """Reconstruction and named loss terms for true motion given its speech."""
        ...

    def sample(self, speech: Float[Tensor, "B T S"], seeds: list[int]) -> Float[Tensor, "B T 3"]:
        """Sample rotation vectors, one seed per row. The result of a seed does not depend on the rest of the batch."""
        ...


@runtime_checkable
class HeadLikelihood(Protocol):
    """Further member of a head generator whose true motion has a likelihood."""

    def log_likelihood(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> dict[str, Tensor]:
        """Named terms of the log-likelihood of true head motion, in nats per row."""
        ...
