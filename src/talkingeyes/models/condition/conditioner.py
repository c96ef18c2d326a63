"""Conditioning of a model on more than its own speech: the speaker, the emotion.

Each kind is one file of this folder and one entry of the list `conditions` in conf/model/; `[]` means no conditioning
(the paper). A conditioner yields vectors that are concatenated with the speech features, so they reach every generator
of head and gaze.
"""

from __future__ import annotations

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
        "emotion": "talkingeyes.models.condition.emotion_embedding:EmotionEmbedding",
    },
    ("required_inputs", "forward"),
)
ConditionSettings = Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(CONDITIONERS.parse)]

InputName = Literal["speaker", "emotion", "sound"]


@dataclass(frozen=True)
class ConditioningInputs:
    """Conditioning of B windows of T frames. None: unconditional; speaker -1: unconditional for this window.

    `speaker` is an index into the list of the training speakers, followed by their mirror images. `emotion` has the
    strengths of emotions (`emotion_strength.py`) of every frame, or of all frames; None: neutral. `sound` is the
    waveform of the speech, N / T samples per frame.
    """

    speaker: Int[Tensor, " B"] | None = None
    emotion: Float[Tensor, "B _ E"] | None = None
    sound: Float[Tensor, "B N"] | None = None

    def to(self, device: torch.device) -> ConditioningInputs:
        """A copy on a device."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return ConditioningInputs(**{name: None if each is None else each.to(device) for name, each in found.items()})


NO_CONDITIONING = ConditioningInputs()


@dataclass(frozen=True)
class ConditioningSpec:
    """What a conditioner is built for: the channels of the embedding, and the training speakers in index order."""

    channels: tuple[str, ...]
    speakers: tuple[str, ...]


@dataclass(frozen=True)
class ConditionFeatures:
    """Condition vectors of B windows for the head and the gaze generator: one per frame, or one for all frames."""

    head: Float[Tensor, "B _ S"]
    gaze: Float[Tensor, "B _ S"]

    @classmethod
    def shared(cls, both: Float[Tensor, "B _ S"]) -> ConditionFeatures:
        """The same vectors for head and gaze."""
        return cls(both, both)


@runtime_checkable
class Conditioner(Protocol):
    """Protocol of a torch module `Class(settings, width, spec)`; `width` is the number of speech features."""

    settings_class: Any
    # Inputs that must be provided; inputs that no conditioner requires are not loaded.
    required_inputs: tuple[InputName, ...]

    def forward(self, conditioning: ConditioningInputs, batch_size: int) -> ConditionFeatures:
        """Condition vectors of `batch_size` windows."""
        ...


def condition_dropout_mask(batch_size: int, probability: float, training: bool, device: torch.device) -> Tensor:
    """Random mask of windows to train unconditionally, so that the model also works without the condition (one bool per
    row)."""
    if not training or not probability:
        return torch.zeros(batch_size, dtype=torch.bool, device=device)
    return torch.rand(batch_size, device=device) < probability
