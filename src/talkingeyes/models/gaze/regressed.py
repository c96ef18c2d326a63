"""The cross-modal decoder of gaze as the paper writes it (TalkingEyes eq. 9, 10, 11, 12 and 14).

Features are regressed from past gaze, speech and head, replaced by their nearest codes, and decoded by the frozen D_VQ.
At temperature 0 this is the paper; above it, a code is drawn by a softmax over distances in units of the nearest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import PartSettings
from talkingeyes.models import losses
from talkingeyes.models.gaze.generator import Condition, uniforms
from talkingeyes.models.gaze.history import FreeHistory, HistorySettings, NoisyHistory, ScheduledHistory, replaced
from talkingeyes.models.gaze.signal import gaze_of, signal_of
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.draw import draw
from talkingeyes.models.layers.quantisers import AnyQuantiser
from talkingeyes.models.layers.transformer import CausalTransformer, CrossWindow, TransformerSettings


class RegressedGazeSettings(PartSettings):
    """The decoder of features."""

    kind: Literal["regressed"]
    transformer: TransformerSettings
    # Frames of condition that cross-attention sees before and after its own.
    condition_back: Annotated[int, Field(ge=0)]
    condition_ahead: Annotated[int, Field(ge=0)]
    # What is seen of the past in training.
    history: HistorySettings


@dataclass(frozen=True)
class _Predicted:
    """Features, the values of the codes that stand for them, and what D_VQ makes of these (radians)."""

    features: Float[Tensor, "B T C"]
    codes: Float[Tensor, "B T C"]
    signal: Float[Tensor, "B T F"]


class RegressedGaze(nn.Module):
    """D_cross-modal: queries are embedded past gaze, keys and values the embedded speech and head."""

    configured_by = RegressedGazeSettings

    def __init__(self, settings: RegressedGazeSettings, speech: int, codebook: GazeVQVAE | None) -> None:
        super().__init__()
        if codebook is None:
            raise InputError("model.prior: should name a codebook for regressed gaze, got null")
        if codebook.settings.frames_per_code != 1 or codebook.stay_tolerance_rad is not None:
            raise InputError("model.prior: should have one code a frame and no stay token for regressed gaze")
        self.settings, self.codebook, self.trained_steps = settings, codebook, 0
        width = settings.transformer.width
        self.embed = nn.Linear(len(codebook.mean), width)
        self.condition = nn.Linear(speech + 3, width)
        self.transformer = CausalTransformer(
            settings.transformer, CrossWindow(settings.condition_back, settings.condition_ahead)
        )
        self.out = nn.Linear(width, codebook.settings.quantiser.width)

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """The codebook has statistics of its own."""

    def terms(self, condition: Condition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Losses of frames, each predicted from those before it; `copy_last` is that of copying the true one before."""
        true = self._normal(signal_of(self.codebook.settings.signal, condition.head, gaze))
        past, memory, history = _before(true), self._memory(condition), self.settings.history
        if self.training and isinstance(history, FreeHistory):
            made = self._run(memory, lambda features, _: self._nearest(features), history.gradient_frames)
        else:
            made = self._predict(self._shown(past, memory), memory)
        predicted = self._normal(made.signal)
        return {
            "gaze_reconstruction": losses.reconstruction(predicted, true),
            "gaze_velocity": losses.velocity(predicted, true),
            "gaze_regularity": F.mse_loss(self.codebook.quantiser.among_codes(made.features), made.codes),
            "copy_last": losses.reconstruction(past, true).detach(),
        }

    @torch.no_grad()
    def sample(self, condition: Condition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Frame after frame (eq. 10), with caches in both networks instead of decoding the prefix again."""
        memory = self._memory(condition)
        uniform = uniforms(seeds, memory.shape[1]).to(memory.device)

        def drawn(features: Float[Tensor, "B C"], step: int) -> Float[Tensor, "B C"]:
            return lookup(self.codebook.quantiser, features, uniform[:, step], temperature)

        return gaze_of(self.codebook.settings.signal, condition.head, self._run(memory, drawn, None).signal)

    def _predict(self, past: Float[Tensor, "B T F"], memory: Float[Tensor, "B T W"]) -> _Predicted:
        """All frames at once, each from a past that is given."""
        features = self.out(self.transformer(self.embed(past), memory))
        quantised = self.codebook.quantiser(features)
        stay = torch.zeros(past.shape[:2], dtype=torch.bool, device=past.device)
        signal = self.codebook.decode(quantised.values, stay)
        return _Predicted(features, self.codebook.quantiser.codebook[quantised.indices], signal)

    def _shown(self, past: Float[Tensor, "B T F"], memory: Float[Tensor, "B T W"]) -> Float[Tensor, "B T F"]:
        """What a training step shows of the true past."""
        history = self.settings.history
        if not self.training:
            return past
        if isinstance(history, NoisyHistory):
            return past + history.sigma * torch.randn_like(past)
        if isinstance(history, ScheduledHistory):
            with torch.no_grad():
                own = _before(self._normal(self._predict(past, memory).signal))
            return torch.where(replaced(history, self.trained_steps, past)[..., None], own, past)
        return past

    def _run(
        self,
        memory: Float[Tensor, "B T W"],
        choose: Callable[[Float[Tensor, "B C"], int], Float[Tensor, "B C"]],
        gradient_frames: int | None,
    ) -> _Predicted:
        """Free running: each frame from those made before it; `choose` gives code values for the features of a frame.

        The gradient goes back through at most `gradient_frames` frames (null: all), cut at every so many of them.
        """
        batch, frames = memory.shape[:2]
        cache, decoding = self.transformer.start(memory), self.codebook.decoder.start()
        moving = torch.zeros(batch, dtype=torch.bool, device=memory.device)
        past = self.codebook.mean.expand(batch, -1)
        features, codes, made = [], [], []
        for step in range(frames):
            if gradient_frames is not None and step % gradient_frames == 0:
                past = past.detach()
                cache.forget_gradient()
                decoding.forget_gradient()
            entered = self.embed(self._normal(past))[:, None]
            features.append(self.out(self.transformer.step(entered, cache))[:, 0])
            values = choose(features[-1], step)
            past = self.codebook.step(values, moving, past, decoding)[:, 0]
            codes.append(values.detach())
            made.append(past)
        return _Predicted(torch.stack(features, dim=1), torch.stack(codes, dim=1), torch.stack(made, dim=1))

    def _nearest(self, features: Float[Tensor, "B C"]) -> Float[Tensor, "B C"]:
        """Eq. 5, straight through."""
        values: Tensor = self.codebook.quantiser(features[:, None]).values[:, 0]
        return values

    def _normal(self, signal: Float[Tensor, "*B F"]) -> Float[Tensor, "*B F"]:
        return (signal - self.codebook.mean) / self.codebook.scale

    def _memory(self, condition: Condition) -> Float[Tensor, "B T W"]:
        out: Tensor = self.condition(torch.cat([condition.speech, condition.head_normal], dim=-1))
        return out


def _before(true: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
    """What was before each frame; before the first, the mean."""
    return torch.cat([torch.zeros_like(true[:, :1]), true[:, :-1]], dim=1)


def lookup(
    quantiser: AnyQuantiser, features: Float[Tensor, "B C"], uniform: Float[Tensor, " B"], temperature: float
) -> Float[Tensor, "B C"]:
    """Code values for features: the nearest (eq. 5), or drawn by softmax(-distance / (temperature * nearest))."""
    distance = quantiser.distances(features).clamp(min=0).sqrt()
    nearest = distance.min(-1, keepdim=True).values.clamp(min=1e-6)
    return quantiser.codebook[draw(-distance / nearest, uniform, temperature)]
