"""Transformer VQ-VAE of gaze (TalkingEyes section IV-C, eq. 5 to 7): E_VQ, the codebook and D_VQ.

Encoder and decoder are causal with attention over a fixed past, so the cost is linear in the length of speech and
streaming is possible. A code spans `frames_per_code` frames: 1 as in the paper; with 4, the decoder that predicts codes
does not freeze in free running (docs/log.md). With a stay tolerance, a patch that does not move has no code: it copies
the frame before it exactly. Rendered frames within the tolerance also copy it, so that codes cannot jitter while gaze
rests.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.models.gaze.gaze_signal import SIGNAL_DIMS, SignalName
from talkingeyes.models.layers.freezing import FreezableModule
from talkingeyes.models.layers.quantiser import QuantiserOutput
from talkingeyes.models.layers.quantiser_factory import AnyQuantiserSettings, make_quantiser
from talkingeyes.models.layers.transformer import Cache, CausalTransformer, TransformerSettings
from talkingeyes.models.losses import Norm, is_standardised


class GazeVQVAESettings(Settings):
    """Signal and sizes of the codebook and its networks."""

    # eye_in_head (the paper's P^e, 6 numbers) or gaze_in_space (4 numbers).
    signal: SignalName
    # Frames per code.
    frames_per_code: Annotated[int, Field(gt=0)]
    # A patch that moves less than this (degrees) from the frame before it is a stay; null: every patch has a code.
    stay_tolerance_deg: Annotated[float, Field(gt=0)] | None
    # Norm of the losses, here and in a decoder that regresses its features (models/losses.py).
    norm: Norm
    # Whether the networks work on a signal in standard deviations, as always with standardised_mean, or in radians.
    standardised: bool
    quantiser: AnyQuantiserSettings
    encoder: TransformerSettings
    decoder: TransformerSettings


@dataclass(frozen=True)
class Reconstruction:
    """A signal reconstructed through the codebook."""

    signal: Float[Tensor, "B T F"]
    quantised: QuantiserOutput


class GazeVQVAE(FreezableModule):
    """E_VQ, Q and D_VQ over signals in radians, frozen while the gaze generator is trained (section IV-D). If
    standardised, with a mean per dimension and one scale for all."""

    mean: Tensor
    scale: Tensor

    def __init__(self, settings: GazeVQVAESettings) -> None:
        super().__init__()
        self.settings = settings
        numbers = SIGNAL_DIMS[settings.signal] * settings.frames_per_code
        self.register_buffer("mean", torch.zeros(SIGNAL_DIMS[settings.signal]))
        self.register_buffer("scale", torch.ones(()))
        self.input_projection = nn.Linear(numbers, settings.encoder.width)
        self.encoder = CausalTransformer(settings.encoder)
        self.to_latent = nn.Linear(settings.encoder.width, settings.quantiser.width)
        self.quantiser = make_quantiser(settings.quantiser)
        self.from_code = nn.Linear(settings.quantiser.width, settings.decoder.width)
        self.stay = nn.Parameter(torch.zeros(settings.quantiser.width))
        self.decoder = CausalTransformer(settings.decoder)
        self.out = nn.Linear(settings.decoder.width, numbers)

    @property
    def stay_tolerance_rad(self) -> float | None:
        degrees = self.settings.stay_tolerance_deg
        return None if degrees is None else math.radians(degrees)

    def normalise_by(self, mean: Float[Tensor, " F"], scale: float) -> None:
        """Set the statistics that normalise a signal, unless it stays in radians."""
        if is_standardised(self.settings.norm, self.settings.standardised):
            self.mean.copy_(mean)
            self.scale.fill_(scale)

    @property
    def loss_scale(self) -> float:
        """From a normalised signal to the unit of the losses."""
        return 1.0 if self.settings.norm == "standardised_mean" else float(self.scale)

    def patches(self, signal: Float[Tensor, "B T F"]) -> Float[Tensor, "B N P F"]:
        """The signal in patches of `frames_per_code` frames; T must be a multiple."""
        patches: Tensor = signal.unflatten(1, (-1, self.settings.frames_per_code))
        return patches

    def encode(self, signal: Float[Tensor, "B T F"]) -> Float[Tensor, "B N C"]:
        """Latents of patches: E_VQ."""
        normal = self.patches((signal - self.mean) / self.scale).flatten(2)
        latent: Tensor = self.to_latent(self.encoder(self.input_projection(normal)))
        return latent

    def decode(self, values: Float[Tensor, "B N C"], stay: Bool[Tensor, "B N"]) -> Float[Tensor, "B T F"]:
        """D_VQ: the signal of code values; stays copy the frame before them."""
        values = torch.where(stay[..., None], self.stay, values)
        decoded = self._to_patches(self.decoder(self.from_code(values)))
        order = torch.arange(stay.shape[1], device=stay.device).expand_as(stay)
        last = torch.where(stay, 0, order).cummax(dim=1).values
        last_frame = decoded[torch.arange(len(decoded), device=stay.device)[:, None], last][:, :, -1:]
        return torch.where(stay[..., None, None], last_frame, decoded).flatten(1, 2)

    def forward(self, signal: Float[Tensor, "B T F"], stay: Bool[Tensor, "B N"]) -> Reconstruction:
        """Eq. 6. Stays do not update the codebook."""
        quantised = self.quantiser(self.encode(signal), ~stay)
        return Reconstruction(self.decode(quantised.values, stay), quantised)

    def code_values(self, indices: Int[Tensor, "*N"]) -> Float[Tensor, "*N C"]:
        """Code values of indices; the index `codes` is the stay token."""
        table = torch.cat([self.quantiser.codebook, self.stay[None]])
        return table[indices]

    def render(self, values: Float[Tensor, "B N C"], stay: Bool[Tensor, "B N"]) -> Float[Tensor, "B T F"]:
        """The decoded signal with frames within the stay tolerance held."""
        signal = self.decode(values, stay)
        return self._hold_still(signal, signal[:, 0])

    def step(
        self,
        values: Float[Tensor, "B C"],
        stay: Bool[Tensor, " B"],
        last_frame: Float[Tensor, "B F"] | None,
        cache: Cache,
    ) -> Float[Tensor, "B P F"]:
        """`render` for one code at a time; `last_frame` is the last frame so far (None before the first)."""
        values = torch.where(stay[:, None], self.stay, values)
        decoded = self._to_patches(self.decoder.step(self.from_code(values)[:, None], cache))[:, 0]
        if last_frame is None:
            return self._hold_still(decoded, decoded[:, 0])
        return self._hold_still(
            torch.where(stay[:, None, None], last_frame[:, None].expand_as(decoded), decoded), last_frame
        )

    def _hold_still(self, signal: Float[Tensor, "B T F"], last_frame: Float[Tensor, "B F"]) -> Float[Tensor, "B T F"]:
        if self.stay_tolerance_rad is None:
            return signal
        frames = []
        for frame in signal.unbind(1):
            near = (frame - last_frame).abs().amax(-1, keepdim=True) < self.stay_tolerance_rad
            last_frame = torch.where(near, last_frame, frame)
            frames.append(last_frame)
        return torch.stack(frames, dim=1)

    def _to_patches(self, features: Float[Tensor, "B N W"]) -> Float[Tensor, "B N P F"]:
        out: Tensor = self.out(features).unflatten(-1, (self.settings.frames_per_code, -1))
        return out * self.scale + self.mean
