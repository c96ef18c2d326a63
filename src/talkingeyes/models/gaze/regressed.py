"""The cross-modal decoder of gaze as the paper writes it (TalkingEyes eq. 9, 10, 11, 12 and 14).

Features are regressed from past gaze, speech and head, replaced by their nearest codes, and decoded by the frozen D_VQ.
At temperature 0 this is the paper; above it, a code is drawn by a softmax over distances in units of the nearest.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.errors import InputError
from talkingeyes.models import losses
from talkingeyes.models.gaze.generator import Condition, uniforms
from talkingeyes.models.gaze.signal import gaze_of, signal_of
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.draw import draw
from talkingeyes.models.layers.quantiser import Quantiser
from talkingeyes.models.layers.transformer import CausalTransformer, CrossWindow, TransformerSettings
from talkingeyes.settings import PartSettings


class RegressedGazeSettings(PartSettings):
    """The decoder of features."""

    kind: Literal["regressed"]
    transformer: TransformerSettings
    # Frames of condition that cross-attention sees before and after its own.
    condition_back: Annotated[int, Field(ge=0)]
    condition_ahead: Annotated[int, Field(ge=0)]


class RegressedGaze(nn.Module):
    """D_cross-modal: queries are embedded past gaze, keys and values the embedded speech and head."""

    configured_by = RegressedGazeSettings

    def __init__(self, settings: RegressedGazeSettings, speech: int, codebook: GazeVQVAE | None) -> None:
        super().__init__()
        if codebook is None:
            raise InputError("model.prior: should name a codebook for regressed gaze, got null")
        if codebook.settings.frames_per_code != 1 or codebook.stay_tolerance_rad is not None:
            raise InputError("model.prior: should have one code a frame and no stay token for regressed gaze")
        self.codebook = codebook
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
        """Losses of all frames, each predicted from true frames before it; beside them what copying the last gives."""
        signal = signal_of(self.codebook.settings.signal, condition.head, gaze)
        true = (signal - self.codebook.mean) / self.codebook.scale
        past = torch.cat([torch.zeros_like(true[:, :1]), true[:, :-1]], dim=1)
        features = self.out(self.transformer(self.embed(past), self._memory(condition)))
        quantised = self.codebook.quantiser(features)
        stay = torch.zeros(true.shape[:2], dtype=torch.bool, device=true.device)
        predicted = (self.codebook.decode(quantised.values, stay) - self.codebook.mean) / self.codebook.scale
        return {
            "gaze_reconstruction": losses.reconstruction(predicted, true),
            "gaze_velocity": losses.velocity(predicted, true),
            "gaze_regularity": F.mse_loss(features, self.codebook.quantiser.codebook[quantised.indices]),
            "copy_last": losses.reconstruction(past, true).detach(),
        }

    @torch.no_grad()
    def sample(self, condition: Condition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Frame after frame (eq. 10), with caches in both networks instead of decoding the prefix again."""
        memory = self._memory(condition)
        batch, frames = memory.shape[:2]
        cache, decoding = self.transformer.start(memory), self.codebook.decoder.start()
        uniform = uniforms(seeds, frames).to(memory.device)
        moving = torch.zeros(batch, dtype=torch.bool, device=memory.device)
        past = self.codebook.mean.expand(batch, -1)
        made = []
        for step in range(frames):
            normal = (past - self.codebook.mean) / self.codebook.scale
            features = self.out(self.transformer.step(self.embed(normal)[:, None], cache))[:, 0]
            values = lookup(self.codebook.quantiser, features, uniform[:, step], temperature)
            past = self.codebook.step(values, moving, past, decoding)[:, 0]
            made.append(past)
        signal = torch.stack(made, dim=1)
        return gaze_of(self.codebook.settings.signal, condition.head, signal)

    def _memory(self, condition: Condition) -> Float[Tensor, "B T W"]:
        out: Tensor = self.condition(torch.cat([condition.speech, condition.head_normal], dim=-1))
        return out


def lookup(
    quantiser: Quantiser, features: Float[Tensor, "B C"], uniform: Float[Tensor, " B"], temperature: float
) -> Float[Tensor, "B C"]:
    """Code values for features: the nearest (eq. 5), or drawn by softmax(-distance / (temperature * nearest))."""
    distance = quantiser.distances(features).clamp(min=0).sqrt()
    nearest = distance.min(-1, keepdim=True).values.clamp(min=1e-6)
    return quantiser.codebook[draw(-distance / nearest, uniform, temperature)]
