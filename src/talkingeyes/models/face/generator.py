"""What every face generator is: it learns the face from speech fused with style, and samples it.

A generator is one file here: `latent` (ProbTalk3D and its VAE variant), `diffusion` (in the manner of FaceDiffuser),
`regression` (of FaceFormer), `codes` (of CodeTalker).
"""

from __future__ import annotations

from typing import Annotated, Any, Protocol

from jaxtyping import Float
from pydantic import BeforeValidator, SerializeAsAny
from torch import Tensor

from talkingeyes.core.settings import ComponentRegistry, ComponentSettings

FACE_GENERATORS = ComponentRegistry(
    "face generator",
    {
        "latent": "talkingeyes.models.face.latent:LatentFace",
        "diffusion": "talkingeyes.models.face.diffusion:DiffusionFace",
        "autoregression": "talkingeyes.models.face.autoregression:RegressionFace",
        "autoregressive_codes": "talkingeyes.models.face.autoregressive_codes:AutoregressiveCodesFace",
    },
    ("normalise_by", "loss_terms", "sample"),
)
FaceComponentSettings = Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(FACE_GENERATORS.parse)]


class FaceGenerator(Protocol):
    """The role: a torch module made as `Class(settings, speech, numbers, tokenizer)`.

    `speech` features a frame, already multiplied by the style; `numbers` of expression and jaw; `tokenizer` is the
    frozen autoencoder that conf/model/ names, or None.
    """

    settings_class: Any

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Take the statistics of faces in the train split; one with a tokenizer needs none."""
        ...

    def loss_terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Named terms of the loss for true faces."""
        ...

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """Faces of one speech in their own units, a seed a row; a seed gives the same alone or with others."""
        ...
