"""wav2vec 2.0 fine-tuned with a model, as in the paper: its last layers are trained, the layers below are frozen.

The convolutions and the first transformer layers of a released checkpoint are frozen. The output of the last layer is
interpolated to motion frames. A sound longer than `window_s` is processed in windows that are crossfaded. The `embed`
stage computes the same features without training, at a small fraction of the cost (conf/embed/wav2vec2.yaml).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.audio.windows import FrameGrid, crossfade_weight, window_starts
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.models.speech_projection import SpeechProjectionSettings

if TYPE_CHECKING:
    from transformers import Wav2Vec2Config, Wav2Vec2Model


class WaveformEncoderSettings(Settings):
    """The encoder of waveforms, and its trainable part."""

    # A local folder or a hub name of a wav2vec 2.0 model.
    checkpoint: Annotated[str, Field(min_length=1)]
    # Number of trained transformer layers, counted from the last.
    trainable_layers: Annotated[int, Field(ge=0)]
    window_s: Annotated[float, Field(ge=1, le=30)]
    overlap_s: Annotated[float, Field(ge=0, lt=1)]


class WaveformSpeechSettings(SpeechProjectionSettings):
    """A projection of wav2vec 2.0 features and of the embedding channels that it names."""

    waveform_encoder: WaveformEncoderSettings


class WaveformEncoder(nn.Module):
    """From sound to features per motion frame."""

    def __init__(self, settings: WaveformEncoderSettings, architecture: Mapping[str, Any] | None) -> None:
        """`architecture` rebuilds the network of a trained model, whose weights are loaded afterwards; None loads the
        checkpoint.

        Raises InputError if it cannot be loaded, or has fewer layers than are to be trained.
        """
        super().__init__()
        self.settings = settings
        self.network = _network(settings, architecture)
        config = self.network.config
        if settings.trainable_layers > config.num_hidden_layers:
            raise InputError(
                f"speech.waveform_encoder.trainable_layers: should be at most {config.num_hidden_layers}, "
                f"got {settings.trainable_layers}"
            )
        self.first_trained = config.num_hidden_layers - settings.trainable_layers
        self.stride = FrameGrid.of_convolutions(tuple(config.conv_kernel), tuple(config.conv_stride))
        self.channels = tuple(f"wave_{index}" for index in range(config.hidden_size))
        self.network.requires_grad_(False)
        for layer in self.trainable_modules():
            layer.requires_grad_(True)

    def trainable_modules(self) -> list[nn.Module]:
        """The trainable layers."""
        return list(self.network.encoder.layers[self.first_trained :])

    def architecture(self) -> dict[str, Any]:
        """The configuration that rebuilds the network without its checkpoint."""
        found: dict[str, Any] = self.network.config.to_diff_dict()
        return found

    def train(self, mode: bool = True) -> WaveformEncoder:
        """Set training mode; frozen layers stay in evaluation mode (no dropout, no masks, no skipped layers)."""
        super().train(mode)
        self.network.eval()
        for layer in self.trainable_modules():
            layer.train(mode)
        return self

    def forward(self, sound: Float[Tensor, "B N"], frames: int) -> Float[Tensor, "B T H"]:
        """Features at `frames` times, the first at the first sample, N / T samples apart."""
        step = sound.shape[1] / frames
        times = np.arange(frames) * step
        sound = nn.functional.pad(sound, (0, max(self.stride.receptive_field - sound.shape[1], 0)))
        parts, weights = [], []
        overlap = round(self.settings.overlap_s * SAMPLE_RATE)
        for start in window_starts(sound.shape[1], round(self.settings.window_s * SAMPLE_RATE), overlap):
            part = sound[:, start : start + round(self.settings.window_s * SAMPLE_RATE)]
            inside = slice(*np.searchsorted(times, [start, start + part.shape[1]]))
            positions = torch.from_numpy((times[inside] - start - self.stride.first) / self.stride.samples)
            weight = torch.from_numpy(crossfade_weight(times[inside] - start, part.shape[1], float(overlap))).to(sound)[
                :, None
            ]
            around = (0, 0, inside.start, frames - inside.stop)
            encoded = interpolate_at(self._encoded(part), positions.to(sound))
            parts.append(nn.functional.pad(encoded * weight, around))
            weights.append(nn.functional.pad(weight, around))
        return torch.stack(parts).sum(0) / torch.stack(weights).sum(0)

    def _encoded(self, sound: Float[Tensor, "B N"]) -> Float[Tensor, "B K H"]:
        """Normalise to zero mean and unit variance, as the feature extractors of released checkpoints do, and
        encode."""
        normal = (sound - sound.mean(1, keepdim=True)) / (sound.var(1, correction=0, keepdim=True) + 1e-7).sqrt()
        encoded: Tensor = self.network(normal).last_hidden_state
        return encoded


def interpolate_at(features: Float[Tensor, "B K H"], positions: Float[Tensor, " T"]) -> Float[Tensor, "B T H"]:
    """Linear interpolation at fractional indices; beyond the ends, the end value is repeated."""
    place = positions.clamp(0, features.shape[1] - 1)
    low = place.floor().long().clamp(max=max(features.shape[1] - 2, 0))
    high = (low + 1).clamp(max=features.shape[1] - 1)
    share = (place - low)[:, None]
    return features[:, low] * (1 - share) + features[:, high] * share


def _network(settings: WaveformEncoderSettings, architecture: Mapping[str, Any] | None) -> Wav2Vec2Model:
    try:
        from transformers import Wav2Vec2Config, Wav2Vec2Model
    except ImportError:
        raise InputError("speech.waveform_encoder: should have the package transformers installed, got none") from None
    if architecture is not None:
        return Wav2Vec2Model(Wav2Vec2Config.from_dict(dict(architecture)))
    try:
        config: Wav2Vec2Config = Wav2Vec2Config.from_pretrained(settings.checkpoint)
        if config.model_type != "wav2vec2":
            raise InputError(f"speech.waveform_encoder.checkpoint: should be a wav2vec2 model, got {config.model_type}")
        return Wav2Vec2Model.from_pretrained(settings.checkpoint, config=config)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"speech.waveform_encoder.checkpoint: should be a local folder or a reachable hub name, got "
            f"{settings.checkpoint!r} ({error})"
        ) from None
