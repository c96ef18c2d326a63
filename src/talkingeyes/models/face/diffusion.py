"""Diffusion of the face after FaceDiffuser (Stan et al. 2023): a recurrent network predicts the clean face.

It is trained to predict x_0 from x_t = sqrt(a_t) x_0 + sqrt(1 - a_t) noise under a cosine schedule (Nichol & Dhariwal
2021). Sampling uses the update of DDIM (Song et al. 2021, eq. 12 and 16): `eta` 1 with all steps is DDPM (Ho et al.
2020); 0 with a few steps is the DDIM of ProbTalk3D's comparison. The data are expression and jaw, where the paper uses
vertices, and there are fewer steps than FaceDiffuser's 500.
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
    """Size of the network, and settings of diffusion and sampling."""

    kind: Literal["diffusion"]
    width: Annotated[int, Field(gt=0, multiple_of=2)]
    layers: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # Diffusion steps in training, and number of steps in sampling.
    diffusion_steps: Annotated[int, Field(gt=1)]
    sampling_steps: Annotated[int, Field(gt=0)]
    # 1: new noise at every step, as in DDPM; 0: noise at the start only, as in DDIM.
    eta: Annotated[float, Field(ge=0, le=1)]


class DiffusionFace(nn.Module):
    """A recurrent denoising network of faces."""

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
        """Set mean and scale of faces."""
        self.normal.set(mean, scale)

    def loss_terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Mean squared error of the denoised expression and jaw, at a random diffusion step per row."""
        true = self.normal(face)
        draw = torch.rand(len(true), device=true.device)
        step = (draw * self.settings.diffusion_steps).long() + 1
        alpha_bar = self.alpha_bar[step][:, None, None]
        noisy = alpha_bar.sqrt() * true + (1 - alpha_bar).sqrt() * torch.randn_like(true)
        return reconstruction(self._denoise(noisy, step, speech), true, squared=True)

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """Denoise from pure noise, one seed per row; `temperature` scales all noise."""
        generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        size = (speech.shape[1], len(self.normal.mean))

        def noise() -> Float[Tensor, "B T F"]:
            gaussian = torch.stack([torch.randn(size, generator=each) for each in generators])
            return temperature * gaussian.to(speech)

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
    """Fraction of the signal that remains (alpha bar) at steps 0 to `steps`."""
    at = torch.arange(steps + 1) / steps
    curve = torch.cos((at + 0.008) / 1.008 * math.pi / 2).square()
    return (curve / curve[0]).clamp(1e-4, 1.0)


def _time_embedding(time: Float[Tensor, " B"], width: int) -> Float[Tensor, "B W"]:
    """Sinusoidal embedding of a time between 0 and 1."""
    angles = time[:, None] * 100.0 ** (torch.arange(width // 2, device=time.device) / (width // 2)) * math.pi
    return torch.cat([angles.sin(), angles.cos()], dim=-1)
