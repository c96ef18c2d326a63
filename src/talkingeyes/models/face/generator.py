"""Interface of face generators: loss terms and sampling of the face from speech features multiplied by the style.

Each generator is one file of this folder: `latent` (ProbTalk3D and its VAE variant), `diffusion` (after FaceDiffuser),
`autoregression` (after FaceFormer), `autoregressive_codes` (after CodeTalker), `causal` (for streams).
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
        "causal": "talkingeyes.models.face.causal:CausalFace",
        "autoregressive_codes": "talkingeyes.models.face.autoregressive_codes:AutoregressiveCodesFace",
    },
    ("normalise_by", "loss_terms", "sample"),
)
FaceComponentSettings = Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(FACE_GENERATORS.parse)]


class FaceGenerator(Protocol):
    """Protocol of a torch module `Class(settings, speech, face_dim, tokenizer)`.

    `speech` is the number of speech features per frame, already multiplied by the style; `face_dim` that of expression
    and jaw. `tokenizer` is the frozen autoencoder named in conf/model/, or None.
    """

    settings_class: Any

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Set the statistics of faces in the train split; generators with a tokenizer ignore them."""
        ...

    def loss_terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Named loss terms for true faces."""
        ...

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """Sample faces for one speech, one seed per row. A seed gives the same result in any batch."""
        ...
