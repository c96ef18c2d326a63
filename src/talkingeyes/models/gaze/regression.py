"""Cross-modal decoder of gaze as in the paper (TalkingEyes eq. 9, 10, 11, 12 and 14).

Features are regressed from past gaze, speech and head, replaced by their nearest codes, and decoded by the frozen D_VQ.
Temperature 0 gives the paper's method. Above 0, a code is sampled by a softmax over distances in units of the nearest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models import losses
from talkingeyes.models.gaze.gaze_signal import split_gaze, to_signal_tensor
from talkingeyes.models.gaze.generator import GazeCondition, concat_padded, uniform_noise
from talkingeyes.models.gaze.history import (
    FreeRunning,
    HistorySettings,
    NoisyTeacherForcing,
    PredictedPast,
    ScheduledSampling,
    replacement_mask,
)
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.categorical_sampling import sample_categorical
from talkingeyes.models.layers.quantiser import Codebook
from talkingeyes.models.layers.transformer import (
    CausalTransformer,
    CrossAttentionWindow,
    TransformerSettings,
    shift_right,
)


class RegressionGazeSettings(ComponentSettings):
    """Settings of the decoder."""

    kind: Literal["regression"]
    transformer: TransformerSettings
    # Numbers of condition frames before and after its own that cross-attention uses; null: all (1:T of eq. 9).
    condition_lookback: Annotated[int, Field(ge=0)] | None
    condition_lookahead: Annotated[int, Field(ge=0)] | None
    # The history used in training.
    history: HistorySettings
    # The quantised features of eq. 14: those nearest to the predicted ones, or the codes of the true motion, as in the
    # code of CodeTalker, whose words eq. 14 has.
    regularity: Literal["nearest_codes", "true_codes"]


@dataclass(frozen=True)
class _Prediction:
    """Features, the values of their codes, and the signal that D_VQ decodes from them (radians)."""

    features: Float[Tensor, "B T C"]
    codes: Float[Tensor, "B T C"]
    signal: Float[Tensor, "B T F"]


class RegressionGaze(nn.Module):
    """D_cross-modal: queries are embedded past gaze, keys and values are embedded speech and head."""

    settings_class = RegressionGazeSettings

    def __init__(self, settings: RegressionGazeSettings, speech: int, codebook: GazeVQVAE | None) -> None:
        super().__init__()
        if codebook is None:
            raise InputError("model.tokenizer: should name a codebook for regressed gaze, got null")
        if codebook.settings.frames_per_code != 1 or codebook.stay_tolerance_rad is not None:
            raise InputError(
                "model.tokenizer: should have one code per frame and no stay token for regressed gaze, "
                f"got {codebook.settings.frames_per_code} frames per code, "
                f"stay_tolerance_rad {codebook.stay_tolerance_rad}"
            )
        self.settings, self.codebook, self.trained_steps = settings, codebook, 0
        width = settings.transformer.width
        self.embed = nn.Linear(len(codebook.mean), width)
        self.condition = nn.Linear(speech + 3, width)
        self.transformer = CausalTransformer(
            settings.transformer, CrossAttentionWindow(settings.condition_lookback, settings.condition_lookahead)
        )
        self.out = nn.Linear(width, codebook.settings.quantiser.width)

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """Do nothing: the codebook has its own statistics."""

    def loss_terms(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Losses of the predicted frames. `copy_last_frame` is the loss of repeating the last true frame, for
        comparison."""
        signal = to_signal_tensor(self.codebook.settings.signal, condition.head, gaze)
        true = self._normal(signal)
        past, memory, history = shift_right(true), self._memory(condition), self.settings.history
        if self.training and isinstance(history, FreeRunning):
            made = self._free_run(memory, lambda features, _: self._nearest(features), history.truncation_frames)
        else:
            made = self._predict(self._training_history(past, memory), memory)
        norm, unit = self.codebook.settings.norm, self.codebook.loss_scale
        predicted, true, past = unit * self._normal(made.signal), unit * true, unit * past
        codes = made.codes if self.settings.regularity == "nearest_codes" else self._codes(signal)
        regularity = F.mse_loss(made.features, codes)
        return {
            "gaze_reconstruction": losses.reconstruction(predicted, true, norm),
            "gaze_velocity": losses.velocity(predicted, true, norm),
            "gaze_regularity": losses.as_norm(regularity, codes, norm),
            "copy_last_frame": losses.reconstruction(past, true, norm).detach(),
        }

    @torch.no_grad()
    def sample(self, condition: GazeCondition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Generate frame by frame (eq. 10), with caches in both networks instead of decoding the prefix again."""
        return self.sample_batch([condition], [seeds], temperature)[0]

    @torch.no_grad()
    def sample_batch(
        self, conditions: Sequence[GazeCondition], seeds: Sequence[list[int]], temperature: float
    ) -> list[Float[Tensor, "_ _ 2 3"]]:
        """`sample` for each of several conditions of any lengths, in one batch."""
        memory, lengths = concat_padded([self._memory(each) for each in conditions])
        uniform = uniform_noise([seed for each in seeds for seed in each], memory.shape[1]).to(memory.device)

        def sample_code(features: Float[Tensor, "B C"], step: int) -> Float[Tensor, "B C"]:
            return sample_code_values(self.codebook.quantiser, features, uniform[:, step], temperature)

        signal = self._free_run(memory, sample_code, None, lengths).signal
        return split_gaze(self.codebook.settings.signal, [each.head for each in conditions], signal)

    def _predict(self, past: Float[Tensor, "B T F"], memory: Float[Tensor, "B T W"]) -> _Prediction:
        """Predict all frames in parallel from a given history."""
        features = self.out(self.transformer(self.embed(past), memory))
        quantised = self.codebook.quantiser(features)
        stay = torch.zeros(past.shape[:2], dtype=torch.bool, device=past.device)
        signal = self.codebook.decode(quantised.values, stay)
        return _Prediction(features, quantised.codes, signal)

    def _training_history(self, past: Float[Tensor, "B T F"], memory: Float[Tensor, "B T W"]) -> Float[Tensor, "B T F"]:
        """The history of a training step."""
        history = self.settings.history
        if not self.training:
            return past
        if isinstance(history, NoisyTeacherForcing):
            return past + history.sigma * torch.randn_like(past)
        if isinstance(history, PredictedPast):
            with torch.no_grad():
                return shift_right(
                    self._normal(self._free_run(memory, lambda each, _: self._nearest(each), None).signal)
                )
        if isinstance(history, ScheduledSampling):
            with torch.no_grad():
                own = shift_right(self._normal(self._predict(past, memory).signal))
            return torch.where(replacement_mask(history, self.trained_steps, past)[..., None], own, past)
        return past

    def _free_run(
        self,
        memory: Float[Tensor, "B T W"],
        select_code: Callable[[Float[Tensor, "B C"], int], Float[Tensor, "B C"]],
        truncation_frames: int | None,
        lengths: Int[Tensor, " B"] | None = None,
    ) -> _Prediction:
        """Free running: each frame from those before it. `select_code` returns code values for the features of a frame.

        The gradient is cut every `truncation_frames` frames (None: never). `lengths`: frames of each row that are no
        padding.
        """
        batch, frames = memory.shape[:2]
        cache, decoder_cache = self.transformer.start(memory, lengths), self.codebook.decoder.start()
        moving = torch.zeros(batch, dtype=torch.bool, device=memory.device)
        past = self.codebook.mean.expand(batch, -1)
        features, codes, made = [], [], []
        for step in range(frames):
            if truncation_frames is not None and step % truncation_frames == 0:
                past = past.detach()
                cache.detach_past()
                decoder_cache.detach_past()
            entered = self.embed(self._normal(past))[:, None]
            features.append(self.out(self.transformer.step(entered, cache))[:, 0])
            values = select_code(features[-1], step)
            past = self.codebook.step(values, moving, past, decoder_cache)[:, 0]
            codes.append(values.detach())
            made.append(past)
        return _Prediction(torch.stack(features, dim=1), torch.stack(codes, dim=1), torch.stack(made, dim=1))

    def _nearest(self, features: Float[Tensor, "B C"]) -> Float[Tensor, "B C"]:
        """Nearest code values (eq. 5), straight through."""
        values: Tensor = self.codebook.quantiser(features[:, None]).values[:, 0]
        return values

    def _codes(self, signal: Float[Tensor, "B T F"]) -> Float[Tensor, "B T C"]:
        """Codes of a true signal."""
        with torch.no_grad():
            codes: Tensor = self.codebook.quantiser(self.codebook.encode(signal)).codes
        return codes

    def _normal(self, signal: Float[Tensor, "*B F"]) -> Float[Tensor, "*B F"]:
        return (signal - self.codebook.mean) / self.codebook.scale

    def _memory(self, condition: GazeCondition) -> Float[Tensor, "B T W"]:
        out: Tensor = self.condition(torch.cat([condition.speech, condition.normalised_head], dim=-1))
        return out


def sample_code_values(
    quantiser: Codebook, features: Float[Tensor, "B C"], uniform: Float[Tensor, " B"], temperature: float
) -> Float[Tensor, "B C"]:
    """Code values of features: the nearest (eq. 5), or sampled by softmax(-distance / (temperature * nearest))."""
    distance = quantiser.distances(features).clamp(min=0).sqrt()
    logits = -distance / distance.min(-1, keepdim=True).values.clamp(min=1e-6)
    factors = logits[0].numel() // logits.shape[-1]
    chosen = sample_categorical(logits.flatten(0, -2), uniform.repeat_interleave(factors), temperature)
    return quantiser.codebook[chosen].reshape(features.shape)
