"""A face by diffusion in the manner of FaceDiffuser (Stan et al. 2023): recurrent, the network says the clean face.

Trained to find x_0 in x_t = sqrt(a_t) x_0 + sqrt(1 - a_t) noise under a cosine schedule (Nichol & Dhariwal 2021).
Sampled by DDIM's update (Song et al. 2021, eq. 12 and 16): with `eta` 1 at every step it is DDPM (Ho et al. 2020),
with 0 at a few steps the DDIM of ProbTalk3D's comparison. It works on expression and jaw, where the paper takes
vertices, and on fewer steps than FaceDiffuser's 500.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Literal

import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.face.autoencoder import FaceAutoencoder, reconstruction
from talkingeyes.models.layers.normaliser import MotionNormaliser


class DiffusionFaceSettings(ComponentSettings):
    """The network and how it is sampled."""

    kind: Literal["diffusion"]
    width: Annotated[int, Field(gt=0, multiple_of=2)]
    layers: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # Steps of noise in training, and how many of them generation takes.
    diffusion_steps: Annotated[int, Field(gt=1)]
    sampling_steps: Annotated[int, Field(gt=0)]
    # 1: noise is drawn anew at every step, as in DDPM; 0: only at the start, as in DDIM.
    eta: Annotated[float, Field(ge=0, le=1)]


class DiffusionFace(nn.Module):
    """A recurrent network that cleans faces."""

    alpha_bar: Tensor
    settings_class = DiffusionFaceSettings

    def __init__(
        self, settings: DiffusionFaceSettings, speech: int, face_dim: int, tokenizer: FaceAutoencoder | None
    ) -> None:
        super().__init__()
        self.settings, self.normal = settings, MotionNormaliser(face_dim)
        self.input_projection = nn.Linear(face_dim, settings.width)
        self.speech_projection = nn.Linear(speech, settings.width)
        self.time_projection = nn.Linear(settings.width, settings.width)
        dropout = settings.dropout if settings.layers > 1 else 0.0
        self.recurrent = nn.GRU(2 * settings.width, settings.width, settings.layers, batch_first=True, dropout=dropout)
        self.out = nn.Linear(settings.width, face_dim)
        self.register_buffer("alpha_bar", _cosine_schedule(settings.diffusion_steps))

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Set what faces are centred on and divided by."""
        self.normal.set(mean, scale)

    def loss_terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """L1 of the cleaned expression and jaw, at a random step of noise a row."""
        true = self.normal(face)
        draw = torch.rand(len(true), device=true.device)
        step = (draw * self.settings.diffusion_steps).long() + 1
        alpha_bar = self.alpha_bar[step][:, None, None]
        noisy = alpha_bar.sqrt() * true + (1 - alpha_bar).sqrt() * torch.randn_like(true)
        return reconstruction(self._denoise(noisy, step, speech), true)

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """From noise to a face, a seed a row; `temperature` scales all noise."""
        generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        size = (speech.shape[1], len(self.normal.mean))

        def noise() -> Float[Tensor, "B T F"]:
            drawn = torch.stack([torch.randn(size, generator=each) for each in generators])
            return temperature * drawn.to(speech)

        speech_features = speech.expand(len(seeds), -1, -1)
        timesteps = (
            torch.linspace(self.settings.diffusion_steps, 0, self.settings.sampling_steps + 1).round().long().tolist()
        )
        x = noise()
        for now, then in pairwise(timesteps):
            clean = self._denoise(x, torch.full((len(seeds),), now, device=x.device), speech_features)
            fresh_noise = noise() if self.settings.eta and then else torch.zeros_like(x)
            x = self._ddim_step(x, clean, now, then, fresh_noise)
        return self.normal.denormalise(x)

    def _ddim_step(
        self,
        x: Float[Tensor, "B T F"],
        clean: Float[Tensor, "B T F"],
        now: int,
        then: int,
        noise: Float[Tensor, "B T F"],
    ) -> Float[Tensor, "B T F"]:
        """Eq. 12 of Song et al.: from step `now` to step `then`."""
        a_now, a_then = self.alpha_bar[now], self.alpha_bar[then]
        direction = (x - a_now.sqrt() * clean) / (1 - a_now).sqrt()
        if then == 0:
            return clean
        sigma = self.settings.eta * ((1 - a_then) / (1 - a_now) * (1 - a_now / a_then)).sqrt()
        return a_then.sqrt() * clean + (1 - a_then - sigma.square()).clamp(min=0).sqrt() * direction + sigma * noise

    def _denoise(
        self, noisy: Float[Tensor, "B T F"], step: Int[Tensor, " B"], speech: Float[Tensor, "B T S"]
    ) -> Float[Tensor, "B T F"]:
        time_projection = self.time_projection(
            _time_embedding(step / self.settings.diffusion_steps, self.settings.width)
        )[:, None]
        x = torch.cat(
            [self.input_projection(noisy) + time_projection, self.speech_projection(speech) + time_projection], dim=-1
        )
        out: Tensor = self.out(self.recurrent(x)[0])
        return out


def _cosine_schedule(steps: int) -> Float[Tensor, " N"]:
    """Share of the signal that is kept (alpha bar) at steps 0 to `steps`."""
    at = torch.arange(steps + 1) / steps
    curve = torch.cos((at + 0.008) / 1.008 * math.pi / 2).square()
    return (curve / curve[0]).clamp(1e-4, 1.0)


def _time_embedding(time: Float[Tensor, " B"], width: int) -> Float[Tensor, "B W"]:
    """Sines and cosines of a time between 0 and 1."""
    angles = time[:, None] * 100.0 ** (torch.arange(width // 2, device=time.device) / (width // 2)) * math.pi
    return torch.cat([angles.sin(), angles.cos()], dim=-1)
