"""Speech to head and gaze: a head generator, then a gaze generator conditioned on it, trained jointly (section IV-D).

`talkingeyes`, `talkingeyes_events`, `talkingeyes_paper` and `vae` are instances of this model with different generators
(conf/model/).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.models.condition.conditioner import (
    CONDITIONERS,
    NO_CONDITIONING,
    Conditioner,
    ConditionFeatures,
    ConditioningInputs,
    ConditioningSpec,
    ConditionSettings,
    InputName,
)
from talkingeyes.models.gaze.generator import (
    GAZE_GENERATORS,
    BatchedGazeGenerator,
    GazeComponentSettings,
    GazeCondition,
    GazeGenerator,
    GazeLikelihood,
    GuidedGazeGenerator,
)
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.head.generator import HEAD_GENERATORS, HeadComponentSettings, HeadGenerator, HeadLikelihood
from talkingeyes.models.speech_projection import (
    CausalSpeechProjectionSettings,
    SpeechProjection,
    SpeechProjectionSettings,
)
from talkingeyes.models.waveform_encoder import WaveformEncoder, WaveformSpeechSettings


class SpeechToMotionSettings(Settings):
    """Components of the model. Weights are keyed by loss term (eq. 15)."""

    kind: Literal["speech_to_motion"]
    # The parts of the motion that the model generates.
    parts: tuple[Literal["head", "gaze"], ...]
    # The pretrained codebook that the gaze generator needs; null: none.
    tokenizer: str | None
    speech: CausalSpeechProjectionSettings | WaveformSpeechSettings | SpeechProjectionSettings
    # Conditioning besides the own speech: entries of models/condition/, perhaps none.
    conditions: tuple[ConditionSettings, ...]
    head: HeadComponentSettings
    gaze: GazeComponentSettings
    # Fraction of the clips of a batch whose gaze is conditioned, in training, on the head generator's reconstruction
    # (the paper: 1), with gradient; the others on the true (fitted) head.
    reconstructed_heads: Annotated[float, Field(ge=0, le=1)]
    weights: dict[str, Annotated[float, Field(ge=0)]]
    # Candidate temperatures, chosen on val by free-running statistics; a single one is used as it is.
    temperatures: tuple[Annotated[float, Field(ge=0)], ...]


@dataclass(frozen=True)
class MotionBatch:
    """Speech embedding and true motion of B windows of T frames."""

    speech: Float[Tensor, "B T C"]
    head: Float[Tensor, "B T 3"]
    gaze: Float[Tensor, "B T 2 3"]
    conditioning: ConditioningInputs = NO_CONDITIONING

    def to(self, device: torch.device) -> MotionBatch:
        """A copy on a device."""
        return MotionBatch(
            self.speech.to(device), self.head.to(device), self.gaze.to(device), self.conditioning.to(device)
        )


@dataclass(frozen=True)
class SpeechInput:
    """A whole speech to generate motions for, a seed per motion; `conditioning` holds one window, the whole speech."""

    embedding: Float[Tensor, "T C"]
    seeds: list[int]
    conditioning: ConditioningInputs = NO_CONDITIONING


@dataclass(frozen=True)
class GeneratedMotion:
    """Sampled head and eye-in-head rotation vectors, one row per seed."""

    head: Float[Tensor, "B T 3"]
    gaze: Float[Tensor, "B T 2 3"]


class SpeechToMotion(nn.Module):
    """The joint model. `temperature` is chosen on val after training and stored with the weights."""

    temperature: Tensor

    def __init__(
        self,
        settings: SpeechToMotionSettings,
        channels: Sequence[str],
        codebook: GazeVQVAE | None,
        speakers: Sequence[str] = (),
        architecture: Mapping[str, Any] | None = None,
    ) -> None:
        """`speakers` are those of the train split; `architecture` rebuilds a waveform encoder without its
        checkpoint."""
        super().__init__()
        self.settings, self.speakers = settings, tuple(speakers)
        speech_settings, names = settings.speech, tuple(channels)
        self.waveform_encoder = (
            WaveformEncoder(speech_settings.waveform_encoder, architecture)
            if isinstance(speech_settings, WaveformSpeechSettings)
            else None
        )
        if self.waveform_encoder is not None:
            own = names if speech_settings.channels is None else speech_settings.channels
            speech_settings = speech_settings.model_copy(update={"channels": (*own, *self.waveform_encoder.channels)})
            names = (*names, *self.waveform_encoder.channels)
        self.speech = SpeechProjection(speech_settings, names)
        width = settings.speech.width * (1 + len(settings.conditions))
        self.head: HeadGenerator = HEAD_GENERATORS.build(settings.head, width)
        self.gaze: GazeGenerator = GAZE_GENERATORS.build(settings.gaze, width, codebook)
        self.register_buffer("temperature", torch.tensor(settings.temperatures[0]))
        spec = ConditioningSpec(tuple(channels), self.speakers)
        self.conditions = nn.ModuleList(
            CONDITIONERS.build(each, settings.speech.width, spec) for each in settings.conditions
        )

    @property
    def conditioners(self) -> list[Conditioner]:
        """The conditioners of the model."""
        return list(self.conditions)  # type: ignore[arg-type]

    @property
    def required_inputs(self) -> frozenset[InputName]:
        """Inputs needed besides the speech embedding."""
        condition_features = frozenset(need for each in self.conditioners for need in each.required_inputs)
        return condition_features | {"sound"} if self.waveform_encoder is not None else condition_features

    def standardise_by(self, mean: Float[Tensor, " C"], std: Float[Tensor, " C"]) -> None:
        """Set the statistics of the embedding; channels of the waveform encoder are not standardised."""
        more = len(self.waveform_encoder.channels) if self.waveform_encoder is not None else 0
        self.speech.standardise_by(F.pad(mean, (0, more)), F.pad(std, (0, more), value=1.0))

    def encode_speech(self, embedding: Float[Tensor, "B T C"], conditioning: ConditioningInputs) -> ConditionFeatures:
        """Speech features concatenated with all condition vectors, per frame. Raises InputError if the model needs the
        waveform and it is missing."""
        return self._add_conditions(
            ConditionFeatures.shared(self._speech_features(embedding, conditioning)), conditioning
        )

    def _speech_features(
        self, embedding: Float[Tensor, "B T C"], conditioning: ConditioningInputs
    ) -> Float[Tensor, "B T S"]:
        if self.waveform_encoder is not None:
            if conditioning.sound is None:
                raise InputError("speech.waveform_encoder: should be given the sound of the speech, got none")
            embedding = torch.cat([embedding, self.waveform_encoder(conditioning.sound, embedding.shape[1])], dim=-1)
        features: Tensor = self.speech(embedding)
        return features

    def _add_conditions(self, speech: ConditionFeatures, conditioning: ConditioningInputs) -> ConditionFeatures:
        condition_features = [each.forward(conditioning, len(speech.head)) for each in self.conditioners]
        head = _concat_features(speech.head, [each.head for each in condition_features])
        same_for_both = speech.gaze is speech.head and all(each.gaze is each.head for each in condition_features)
        return ConditionFeatures(
            head, head if same_for_both else _concat_features(speech.gaze, [each.gaze for each in condition_features])
        )

    def loss_terms(self, batch: MotionBatch) -> dict[str, Tensor]:
        """All loss terms and their weighted sum, `total`. Terms without a weight are only reported.

        Raises InputError for a weight of an unknown term.
        """
        batch = batch.to(self.temperature.device)
        speech = self.encode_speech(batch.speech, batch.conditioning)
        predicted = self.head.predict(speech.head, batch.head)
        seen = self._mix_heads(batch.head, predicted.head)
        condition = GazeCondition(speech.gaze, batch.head, self.head.normal(seen))
        loss_terms = predicted.loss_terms | self.gaze.loss_terms(condition, batch.gaze)
        if unknown := self.settings.weights.keys() - loss_terms.keys():
            raise InputError(f"weights: should be among {', '.join(sorted(loss_terms))}; got {min(unknown)!r}")
        total = sum(weight * loss_terms[name] for name, weight in self.settings.weights.items())
        return {"total": total, **loss_terms}  # type: ignore[dict-item]

    @torch.no_grad()
    def log_likelihood(self, batch: MotionBatch) -> dict[str, Float[Tensor, " B"]]:
        """Log-likelihood of true head motion given speech, and of true gaze given both, in nats per row.

        Terms are named by part (`head_time`); a part whose generator has no likelihood has none.
        """
        batch = batch.to(self.temperature.device)
        speech = self.encode_speech(batch.speech, batch.conditioning)
        terms: dict[str, Tensor] = {}
        if isinstance(self.head, HeadLikelihood):
            found = self.head.log_likelihood(speech.head, batch.head)
            terms |= {f"head_{name}": value for name, value in found.items()}
        if isinstance(self.gaze, GazeLikelihood):
            condition = GazeCondition(speech.gaze, batch.head, self.head.normal(batch.head))
            found = self.gaze.log_likelihood(condition, batch.gaze)
            terms |= {f"gaze_{name}": value for name, value in found.items()}
        return terms

    def _mix_heads(self, true: Float[Tensor, "B T 3"], reconstructed: Float[Tensor, "B T 3"]) -> Float[Tensor, "B T 3"]:
        """The heads that gaze is conditioned on in training, mixed by `reconstructed_heads`."""
        uniform = torch.rand(len(true), device=true.device)
        return torch.where((uniform < self.settings.reconstructed_heads)[:, None, None], reconstructed, true)

    @torch.no_grad()
    def generate(
        self,
        embedding: Float[Tensor, "T C"],
        seeds: list[int],
        temperature: float | None = None,
        conditioning: ConditioningInputs = NO_CONDITIONING,
    ) -> GeneratedMotion:
        """Sample motions for one speech, one row per seed; `conditioning` holds one window, the whole speech."""
        return self.generate_batch([SpeechInput(embedding, seeds, conditioning)], temperature)[0]

    @torch.no_grad()
    def generate_batch(
        self, speeches: Sequence[SpeechInput], temperature: float | None = None
    ) -> list[GeneratedMotion]:
        """`generate` for each of several speeches of any lengths; gaze that is sampled step by step in one batch."""
        heads, conditions = [], []
        for each in speeches:
            features = self._encode_utterance(each.embedding, each.conditioning)
            heads.append(self._sample_head(features, each.seeds))
            conditions.append(self._gaze_condition(features, heads[-1], each.conditioning))
        gazes = self._gaze(conditions, [each.seeds for each in speeches], temperature)
        return [GeneratedMotion(head, gaze) for head, gaze in zip(heads, gazes, strict=True)]

    @torch.no_grad()
    def generate_head(
        self, embedding: Float[Tensor, "T C"], seeds: list[int], conditioning: ConditioningInputs = NO_CONDITIONING
    ) -> Float[Tensor, "B T 3"]:
        """Sample head motion alone, one row per seed."""
        return self._sample_head(self._encode_utterance(embedding, conditioning), seeds)

    @torch.no_grad()
    def generate_gaze(
        self,
        embedding: Float[Tensor, "T C"],
        head: Float[Tensor, "B T 3"],
        seeds: list[int],
        conditioning: ConditioningInputs = NO_CONDITIONING,
    ) -> Float[Tensor, "B T 2 3"]:
        """Sample gaze for the heads of another model, one row per seed."""
        features = self._encode_utterance(embedding, conditioning)
        condition = self._gaze_condition(features, head.to(features.gaze.device), conditioning)
        return self._gaze([condition], [seeds], None)[0]

    def _encode_utterance(self, embedding: Float[Tensor, "T C"], conditioning: ConditioningInputs) -> ConditionFeatures:
        """Features of a whole speech for sampling, one row."""
        device = self.temperature.device
        return self.encode_speech(embedding[None].to(device), conditioning.to(device))

    def _sample_head(self, features: ConditionFeatures, seeds: list[int]) -> Float[Tensor, "B T 3"]:
        return self.head.sample(features.head.expand(len(seeds), -1, -1), seeds)

    def _gaze_condition(
        self, features: ConditionFeatures, head: Float[Tensor, "B T 3"], conditioning: ConditioningInputs
    ) -> GazeCondition:
        """The condition of gaze for B heads of one speech."""
        mean = None
        if self.is_guided:
            still = ConditionFeatures.shared(self.speech.mean_features(head.shape[1]))
            mean = self._add_conditions(still, conditioning.to(head.device)).gaze.expand(len(head), -1, -1)
        return GazeCondition(features.gaze.expand(len(head), -1, -1), head, self.head.normal(head), mean)

    @property
    def is_guided(self) -> bool:
        """Whether sampled gaze is moved away from that of mean speech."""
        return isinstance(self.gaze, GuidedGazeGenerator) and self.gaze.is_guided

    def _gaze(
        self, conditions: Sequence[GazeCondition], seeds: Sequence[list[int]], temperature: float | None
    ) -> list[Float[Tensor, "_ _ 2 3"]]:
        chosen = float(self.temperature) if temperature is None else temperature
        if isinstance(self.gaze, BatchedGazeGenerator):
            return self.gaze.sample_batch(conditions, seeds, chosen)
        return [self.gaze.sample(each, own, chosen) for each, own in zip(conditions, seeds, strict=True)]


def _concat_features(
    features: Float[Tensor, "_ T S"], condition_features: list[Float[Tensor, "_ _ S"]]
) -> Float[Tensor, "B T F"]:
    rows = max(map(len, (features, *condition_features)))
    return torch.cat([each.expand(rows, features.shape[1], -1) for each in (features, *condition_features)], dim=-1)
