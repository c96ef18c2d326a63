"""What a model may be told besides its own speech: who moves, how somebody moves, what the partner says.

Each kind is one file here and one section of the list `conditions` in conf/model/; `[]`: nothing (the paper). A
conditioner gives vectors that stand beside the speech features, so every generator of head and gaze is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from pydantic import BeforeValidator, SerializeAsAny
from torch import Tensor

from talkingeyes.core.settings import ComponentRegistry, ComponentSettings

CONDITIONERS = ComponentRegistry(
    "condition",
    {
        "speaker": "talkingeyes.models.condition.speaker_embedding:SpeakerEmbedding",
        "reference": "talkingeyes.models.condition.style_encoder:StyleEncoder",
        "partner": "talkingeyes.models.condition.partner_speech:PartnerSpeech",
    },
    ("required_inputs", "fit_statistics", "forward"),
)
ConditionSettings = Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(CONDITIONERS.parse)]

InputName = Literal["speaker", "reference", "partner", "sound"]


@dataclass(frozen=True)
class ConditioningInputs:
    """What B windows of T frames come with. None: nothing; a row of NaN (speaker -1): nothing for this window.

    `speaker` is a number in the list of the training speakers (their mirror images come after them), `reference` head
    and eye-in-head (radians) of another clip, `partner` the embedding of the partner's channel, `sound` the speech
    itself, N / T samples a frame.
    """

    speaker: Int[Tensor, " B"] | None = None
    reference: Float[Tensor, "B R 9"] | None = None
    partner: Float[Tensor, "B T C"] | None = None
    sound: Float[Tensor, "B N"] | None = None

    def to(self, device: torch.device) -> ConditioningInputs:
        """The same on a device."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return ConditioningInputs(**{name: None if each is None else each.to(device) for name, each in found.items()})


NO_CONDITIONING = ConditioningInputs()


@dataclass(frozen=True)
class ConditioningSpec:
    """What a conditioner is made for: the channels of the embedding, and the training speakers by number."""

    channels: tuple[str, ...]
    speakers: tuple[str, ...]


@dataclass(frozen=True)
class TrainingStatistics:
    """The train split: statistics of the speech embedding, and motions (head and eye-in-head, radians)."""

    mean: Float[Tensor, " C"]
    std: Float[Tensor, " C"]
    motions: Sequence[Float[Tensor, "R 9"]]


@dataclass(frozen=True)
class ConditionFeatures:
    """What the head's and the gaze's generator are told of B windows: vectors, a row a frame or one for all frames."""

    head: Float[Tensor, "B _ S"]
    gaze: Float[Tensor, "B _ S"]

    @classmethod
    def shared(cls, both: Float[Tensor, "B _ S"]) -> ConditionFeatures:
        """The same for both."""
        return cls(both, both)


@runtime_checkable
class Conditioner(Protocol):
    """The role: a torch module made as `Class(settings, width, known)`, `width` that of the speech features."""

    settings_class: Any
    # What must be given; a model that needs nothing pays for nothing.
    required_inputs: tuple[InputName, ...]

    def fit_statistics(self, statistics: TrainingStatistics) -> None:
        """Take the statistics of the train split."""
        ...

    def forward(self, conditioning: ConditioningInputs, batch_size: int) -> ConditionFeatures:
        """What stands beside the speech features of so many windows."""
        ...


def condition_dropout_mask(batch_size: int, probability: float, training: bool, device: torch.device) -> Tensor:
    """Which windows of a training batch are told nothing, so that a model can also do without (a bool a row)."""
    if not training or not probability:
        return torch.zeros(batch_size, dtype=torch.bool, device=device)
    return torch.rand(batch_size, device=device) < probability
