"""Speech to head and gaze: a head generator, then a gaze generator conditioned on it, trained jointly (section IV-D).

`talkingeyes`, `talkingeyes_paper` and `vae` are this one model with different generators (conf/model/).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field, model_validator
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings, out_of_bounds
from talkingeyes.models.condition.conditioner import (
    CONDITIONERS,
    NOTHING,
    Conditioner,
    ConditionSettings,
    Given,
    Known,
    Need,
    Seen,
    Told,
)
from talkingeyes.models.gaze.generator import GAZE_GENERATORS, Condition, GazeGenerator, GazePartSettings
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.head.generator import HEAD_GENERATORS, HeadGenerator, HeadPartSettings
from talkingeyes.models.layers import share
from talkingeyes.models.speech import CausalSpeechSettings, SpeechInput, SpeechSettings
from talkingeyes.models.wave import WaveEncoder, WaveSpeechSettings


class HeadMixSettings(Settings):
    """The head that gaze is conditioned on in training: shares of the clips of a batch, 1 together."""

    # As it was (fitted).
    truth: Annotated[float, Field(ge=0, le=1)]
    # As the head generator reconstructs it (the paper: 1), with the gradient.
    posterior: Annotated[float, Field(ge=0, le=1)]
    # As the head generator draws it for the speech alone, as in use.
    prior: Annotated[float, Field(ge=0, le=1)]

    @model_validator(mode="after")
    def _whole(self) -> HeadMixSettings:
        if abs(self.truth + self.posterior + self.prior - 1) > 1e-6:
            raise out_of_bounds(
                "truth, posterior and prior should be 1 together", self.truth + self.posterior + self.prior
            )
        return self


class SpeechToMotionSettings(Settings):
    """What the model is made of. Weights name the terms of the loss (eq. 15)."""

    kind: Literal["speech_to_motion"]
    # The parts of a performance that the model gives.
    parts: tuple[Literal["head", "gaze"], ...]
    # The pretrained codebook that the gaze generator needs; null: none.
    prior: str | None
    speech: CausalSpeechSettings | WaveSpeechSettings | SpeechSettings
    # What it is told besides its own speech: parts of models/condition/, perhaps none.
    conditions: tuple[ConditionSettings, ...]
    head: HeadPartSettings
    gaze: GazePartSettings
    head_mix: HeadMixSettings
    weights: dict[str, Annotated[float, Field(ge=0)]]
    # Temperatures to choose from on val, by aliveness; one: taken as it is.
    temperatures: tuple[Annotated[float, Field(ge=0)], ...]

    @model_validator(mode="after")
    def _learns(self) -> SpeechToMotionSettings:
        """Codes that are decoded are moved by their own term alone: without a weight they stay where they began."""
        for part in ("head", "gaze"):
            process = getattr(getattr(self, part), "process", None)
            if getattr(process, "codebook", None) == "vq_vae" and not self.weights.get(f"{part}_codebook"):
                raise out_of_bounds(
                    f"weights.{part}_codebook should be above 0 for {part}.process.codebook=vq_vae",
                    self.weights.get(f"{part}_codebook", "none"),
                )
        return self


@dataclass(frozen=True)
class Batch:
    """Speech embedding and true motion of B windows of T frames."""

    speech: Float[Tensor, "B T C"]
    head: Float[Tensor, "B T 3"]
    gaze: Float[Tensor, "B T 2 3"]
    given: Given = NOTHING

    def to(self, device: torch.device) -> Batch:
        """The same on a device."""
        return Batch(self.speech.to(device), self.head.to(device), self.gaze.to(device), self.given.to(device))


@dataclass(frozen=True)
class Generated:
    """Sampled head and eye-in-head rotation vectors, a row a seed."""

    head: Float[Tensor, "B T 3"]
    gaze: Float[Tensor, "B T 2 3"]


class SpeechToMotion(nn.Module):
    """The joint model. `temperature` is chosen on val after training and kept with the weights."""

    temperature: Tensor

    def __init__(
        self,
        settings: SpeechToMotionSettings,
        channels: Sequence[str],
        codebook: GazeVQVAE | None,
        speakers: Sequence[str] = (),
        architecture: Mapping[str, Any] | None = None,
    ) -> None:
        """`speakers` are those of the train split; `architecture` rebuilds a wave encoder without its checkpoint."""
        super().__init__()
        self.settings, self.speakers = settings, tuple(speakers)
        heard, names = settings.speech, tuple(channels)
        self.wave = WaveEncoder(heard.wave, architecture) if isinstance(heard, WaveSpeechSettings) else None
        if self.wave is not None:
            own = names if heard.channels is None else heard.channels
            heard = heard.model_copy(update={"channels": (*own, *self.wave.channels)})
            names = (*names, *self.wave.channels)
        self.speech = SpeechInput(heard, names)
        width = settings.speech.width * (1 + len(settings.conditions))
        self.head: HeadGenerator = HEAD_GENERATORS.make(settings.head, width)
        self.gaze: GazeGenerator = GAZE_GENERATORS.make(settings.gaze, width, codebook)
        self.register_buffer("temperature", torch.tensor(settings.temperatures[0]))
        known = Known(tuple(channels), self.speakers)
        self.conditions = nn.ModuleList(
            CONDITIONERS.make(each, settings.speech.width, known) for each in settings.conditions
        )

    @property
    def conditioners(self) -> list[Conditioner]:
        """What it is told by."""
        return list(self.conditions)  # type: ignore[arg-type]

    @property
    def needs(self) -> frozenset[Need]:
        """What must be given besides the embedding of the speech."""
        told = frozenset(need for each in self.conditioners for need in each.needs)
        return told | {"sound"} if self.wave is not None else told

    def learn_from(self, seen: Seen) -> None:
        """Take the statistics of the train split; what the wave encoder says has its own scale."""
        more = len(self.wave.channels) if self.wave is not None else 0
        self.speech.standardise_by(F.pad(seen.mean, (0, more)), F.pad(seen.std, (0, more), value=1.0))
        for each in self.conditioners:
            each.learn_from(seen)

    def hear(self, embedding: Float[Tensor, "B T C"], given: Given) -> Told:
        """Speech features, and beside them all that is told, a row a frame. Raises InputError if the waveform is heard
        and missing."""
        if self.wave is not None:
            if given.sound is None:
                raise InputError("speech.wave: a model that hears the waveform needs the sound, got none")
            embedding = torch.cat([embedding, self.wave(given.sound, embedding.shape[1])], dim=-1)
        features: Tensor = self.speech(embedding)
        told = [each.forward(given, len(features)) for each in self.conditioners]
        head = _beside(features, [each.head for each in told])
        alike = all(each.gaze is each.head for each in told)
        return Told(head, head if alike else _beside(features, [each.gaze for each in told]))

    def terms(self, batch: Batch) -> dict[str, Tensor]:
        """All terms of the loss and their weighted sum, `total`. Terms without a weight are only reported.

        Raises InputError for a weight of a term that there is not.
        """
        batch = batch.to(self.temperature.device)
        speech = self.hear(batch.speech, batch.given)
        predicted = self.head.predict(speech.head, batch.head)
        seen = self._seen(speech.head, batch.head, predicted.head)
        condition = Condition(speech.gaze, batch.head, self.head.normal(seen))
        terms = predicted.terms | self.gaze.terms(condition, batch.gaze)
        if unknown := self.settings.weights.keys() - terms.keys():
            raise InputError(f"weights: should be among {', '.join(sorted(terms))}; got {min(unknown)!r}")
        total = sum(weight * terms[name] for name, weight in self.settings.weights.items())
        return {"total": total, **terms}  # type: ignore[dict-item]

    def _seen(
        self, speech: Float[Tensor, "B T S"], true: Float[Tensor, "B T 3"], posterior: Float[Tensor, "B T 3"]
    ) -> Float[Tensor, "B T 3"]:
        """The heads that gaze is conditioned on in training, mixed from all that there are."""
        mix, drawn = self.settings.head_mix, torch.rand(len(true), device=true.device)
        head = torch.where((drawn < mix.posterior)[:, None, None], posterior, true)
        if mix.prior == 0:
            return head
        seeds = share.own(torch.randint(2**31, (len(true) * share.processes(),)).tolist())
        with torch.no_grad():
            prior = self.head.sample(speech, seeds)
        return torch.where((drawn >= 1 - mix.prior)[:, None, None], prior, head)

    @torch.no_grad()
    def generate(
        self,
        embedding: Float[Tensor, "T C"],
        seeds: list[int],
        temperature: float | None = None,
        given: Given = NOTHING,
    ) -> Generated:
        """Motions of one speech, a seed each; `given` is one window, the whole speech."""
        speech = self._heard(embedding, given, len(seeds))
        head = self.head.sample(speech.head, seeds)
        return Generated(head, self._gaze(speech.gaze, head, seeds, temperature))

    @torch.no_grad()
    def turn(self, embedding: Float[Tensor, "T C"], seeds: list[int], given: Given = NOTHING) -> Float[Tensor, "B T 3"]:
        """Heads alone, a seed each."""
        return self.head.sample(self._heard(embedding, given, len(seeds)).head, seeds)

    @torch.no_grad()
    def look(
        self, embedding: Float[Tensor, "T C"], head: Float[Tensor, "B T 3"], seeds: list[int], given: Given = NOTHING
    ) -> Float[Tensor, "B T 2 3"]:
        """Gaze for heads that another model moves, a seed each."""
        speech = self._heard(embedding, given, len(seeds)).gaze
        return self._gaze(speech, head.to(speech.device), seeds, None)

    def _heard(self, embedding: Float[Tensor, "T C"], given: Given, rows: int) -> Told:
        device = self.temperature.device
        one = self.hear(embedding[None].to(device), given.to(device))
        return Told(one.head.expand(rows, -1, -1), one.gaze.expand(rows, -1, -1))

    def _gaze(
        self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"], seeds: list[int], temperature: float | None
    ) -> Float[Tensor, "B T 2 3"]:
        chosen = float(self.temperature) if temperature is None else temperature
        return self.gaze.sample(Condition(speech, head, self.head.normal(head)), seeds, chosen)


def _beside(features: Float[Tensor, "_ T S"], told: list[Float[Tensor, "_ _ S"]]) -> Float[Tensor, "B T F"]:
    rows = max(map(len, (features, *told)))
    return torch.cat([each.expand(rows, features.shape[1], -1) for each in (features, *told)], dim=-1)
