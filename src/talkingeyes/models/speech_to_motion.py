"""Speech to head and gaze: a head generator, then a gaze generator conditioned on it, trained jointly (section IV-D).

`talkingeyes`, `talkingeyes_paper` and `vae` are this one model with different generators (conf/model/).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.models.gaze.generator import GAZE_GENERATORS, Condition, GazeGenerator, GazePartSettings
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.head.generator import HEAD_GENERATORS, HeadGenerator, HeadPartSettings
from talkingeyes.models.speech import CausalSpeechSettings, SpeechInput, SpeechSettings
from talkingeyes.settings import Settings


class SpeechToMotionSettings(Settings):
    """What the model is made of. Weights name the terms of the loss (eq. 15)."""

    kind: Literal["speech_to_motion"]
    # The parts of a performance that the model gives.
    parts: tuple[Literal["head", "gaze"], ...]
    # The pretrained codebook that the gaze generator needs; null: none.
    prior: str | None
    speech: CausalSpeechSettings | SpeechSettings
    head: HeadPartSettings
    gaze: GazePartSettings
    # Share of the clips of a batch whose gaze is conditioned on the reconstructed head (the paper: 1), not the true.
    reconstructed_head: Annotated[float, Field(ge=0, le=1)]
    weights: dict[str, Annotated[float, Field(ge=0)]]
    # Temperatures to choose from on val, by aliveness; one: taken as it is.
    temperatures: tuple[Annotated[float, Field(ge=0)], ...]


@dataclass(frozen=True)
class Batch:
    """Speech embedding and true motion of B windows of T frames."""

    speech: Float[Tensor, "B T C"]
    head: Float[Tensor, "B T 3"]
    gaze: Float[Tensor, "B T 2 3"]

    def to(self, device: torch.device) -> Batch:
        """The same on a device."""
        return Batch(self.speech.to(device), self.head.to(device), self.gaze.to(device))


@dataclass(frozen=True)
class Generated:
    """Sampled head and eye-in-head rotation vectors, a row a seed."""

    head: Float[Tensor, "B T 3"]
    gaze: Float[Tensor, "B T 2 3"]


class SpeechToMotion(nn.Module):
    """The joint model. `temperature` is chosen on val after training and kept with the weights."""

    temperature: Tensor

    def __init__(self, settings: SpeechToMotionSettings, channels: Sequence[str], codebook: GazeVQVAE | None) -> None:
        super().__init__()
        self.settings = settings
        self.speech = SpeechInput(settings.speech, channels)
        self.head: HeadGenerator = HEAD_GENERATORS.make(settings.head, settings.speech.width)
        self.gaze: GazeGenerator = GAZE_GENERATORS.make(settings.gaze, settings.speech.width, codebook)
        self.register_buffer("temperature", torch.tensor(settings.temperatures[0]))

    def terms(self, batch: Batch) -> dict[str, Tensor]:
        """All terms of the loss and their weighted sum, `total`. Terms without a weight are only reported."""
        batch = batch.to(self.temperature.device)
        speech = self.speech(batch.speech)
        predicted = self.head.predict(speech, batch.head)
        replaced = torch.rand(len(batch.head), device=batch.head.device) < self.settings.reconstructed_head
        seen = torch.where(replaced[:, None, None], predicted.head, batch.head)
        condition = Condition(speech, batch.head, self.head.normal(seen))
        terms = predicted.terms | self.gaze.terms(condition, batch.gaze)
        total = sum(weight * terms[name] for name, weight in self.settings.weights.items())
        return {"total": total, **terms}  # type: ignore[dict-item]

    @torch.no_grad()
    def generate(
        self, embedding: Float[Tensor, "T C"], seeds: list[int], temperature: float | None = None
    ) -> Generated:
        """Motions of one speech, a seed each."""
        speech = self.speech(embedding[None].to(self.temperature.device)).expand(len(seeds), -1, -1)
        head = self.head.sample(speech, seeds)
        return Generated(head, self._gaze(speech, head, seeds, temperature))

    @torch.no_grad()
    def look(
        self, embedding: Float[Tensor, "T C"], head: Float[Tensor, "B T 3"], seeds: list[int]
    ) -> Float[Tensor, "B T 2 3"]:
        """Gaze for heads that another model moves, a seed each."""
        device = self.temperature.device
        speech = self.speech(embedding[None].to(device)).expand(len(seeds), -1, -1)
        return self._gaze(speech, head.to(device), seeds, None)

    def _gaze(
        self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"], seeds: list[int], temperature: float | None
    ) -> Float[Tensor, "B T 2 3"]:
        chosen = float(self.temperature) if temperature is None else temperature
        return self.gaze.sample(Condition(speech, head, self.head.normal(head)), seeds, chosen)
