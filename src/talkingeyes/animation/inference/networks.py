"""Networks of the default models in numpy, built from tensors by name: those of models/layers/ and their formulas."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.models.layers.numpy_layers import NumpyConv, NumpyLayerNorm, NumpyLinear, Tensors, gelu

BLOCK_FRAMES = 128  # frames whose attention is computed together
ROTARY_BASE = 10_000


def check_size(tensors: Tensors, enter: str, layers: str, settings: Mapping[str, Any]) -> None:
    """Raises ValueError if the settings name another width or number of layers than the tensors have."""
    numbers = {key.removeprefix(f"{layers}.").split(".")[0] for key in tensors if key.startswith(f"{layers}.")}
    found = len(tensors[f"{enter}.bias"]), len(numbers)
    if found != (settings["width"], settings["layers"]):
        raise ValueError(f"{enter}: its configuration names another network than that of its tensors")


class ConvolutionStack:
    """Residual dilated convolutions (models/layers/convolution.py)."""

    def __init__(self, tensors: Tensors, name: str, settings: Mapping[str, Any]) -> None:
        check_size(tensors, f"{name}.input_projection", f"{name}.norms", settings)
        self._enter = NumpyLinear(tensors, f"{name}.input_projection")
        self._layers = [
            (
                NumpyLayerNorm(tensors, f"{name}.norms.{layer}"),
                NumpyConv(tensors, f"{name}.convolutions.{layer}", 2**layer),
            )
            for layer in range(settings["layers"])
        ]

    def __call__(self, x: Float[ndarray, "B T C"]) -> Float[ndarray, "B T W"]:
        """Features per frame."""
        h = self._enter(x)
        for norm, convolution in self._layers:
            h = h + convolution(gelu(norm(h)))
        return h


class SpeechProjection:
    """Standardised channels of an embedding, projected (models/speech_projection.py)."""

    def __init__(self, tensors: Tensors, settings: Mapping[str, Any]) -> None:
        self._mean, self._std, self._channels = (
            tensors[f"speech.{name}"] for name in ("mean", "std", "channel_indices")
        )
        self._stack = ConvolutionStack(tensors, "speech.stack", settings)

    def __call__(self, embedding: Float[ndarray, "T C"]) -> Float[ndarray, "1 T S"]:
        """Features of one speech."""
        standardised = ((embedding.astype(np.float32) - self._mean) / self._std)[:, self._channels]
        return self._stack(standardised[None]) if len(self._channels) else self.mean_features(len(embedding))

    def mean_features(self, frames: int) -> Float[ndarray, "1 T S"]:
        """Features of mean speech: all standardised channels are zero."""
        return self._stack(np.zeros((1, frames, max(len(self._channels), 1)), np.float32))


class WindowTransformer:
    """Convolution and attention to a window of frames (models/layers/window_transformer.py)."""

    def __init__(self, tensors: Tensors, name: str, settings: Mapping[str, Any]) -> None:
        check_size(tensors, f"{name}.input_projection", f"{name}.layers", settings)
        self._enter = NumpyLinear(tensors, f"{name}.input_projection")
        self._convolution = NumpyConv(tensors, f"{name}.convolution", 1)
        self._layers = [_Layer(tensors, f"{name}.layers.{layer}", settings) for layer in range(settings["layers"])]
        self._norm = NumpyLayerNorm(tensors, f"{name}.norm")

    def __call__(self, x: Float[ndarray, "B T C"]) -> Float[ndarray, "B T W"]:
        """Features per frame."""
        entered = self._enter(x)
        h = entered + self._convolution(entered)
        for layer in self._layers:
            h = layer(h)
        return self._norm(h)


class _Layer:
    """Pre-norm layer: self-attention and feed-forward."""

    def __init__(self, tensors: Tensors, name: str, settings: Mapping[str, Any]) -> None:
        self._norm_self, self._norm_feed = (NumpyLayerNorm(tensors, f"{name}.norm_{part}") for part in ("self", "feed"))
        self._query, self._key_value, self._out = (
            NumpyLinear(tensors, f"{name}.attend_self.{part}") for part in ("query", "key_value", "out")
        )
        self._feed, self._feed_out = (NumpyLinear(tensors, f"{name}.feed.{part}") for part in (0, 2))
        self._heads = settings["heads"]
        self._lookback = math.inf if settings["lookback"] is None else settings["lookback"]
        self._lookahead = settings["lookahead"]

    def __call__(self, x: Float[ndarray, "B T W"]) -> Float[ndarray, "B T W"]:
        x = x + self._attend(self._norm_self(x))
        return np.asarray(x + self._feed_out(gelu(self._feed(self._norm_feed(x)))))

    def _attend(self, x: Float[ndarray, "B T W"]) -> Float[ndarray, "B T W"]:
        """Attention of each frame to frames - lookback .. + lookahead, with rotary positions, in blocks of frames."""
        query, keys, values = self._split(self._query(x), 1)[0], *self._split(self._key_value(x), 2)
        query, keys = _rotate(query) / np.float32(math.sqrt(query.shape[-1])), _rotate(keys)
        mixed, frames = np.empty_like(query), x.shape[1]
        for start in range(0, frames, BLOCK_FRAMES):
            stop = min(start + BLOCK_FRAMES, frames)
            low, high = int(max(start - self._lookback, 0)), min(stop + self._lookahead, frames)
            offset = np.arange(low, high) - np.arange(start, stop)[:, None]
            allowed = (offset >= -self._lookback) & (offset <= self._lookahead)
            scores = query[:, :, start:stop] @ keys[:, :, low:high].swapaxes(-1, -2)
            scores = np.where(allowed, scores, np.float32(-np.inf))
            weights = np.exp(scores - scores.max(-1, keepdims=True))
            mixed[:, :, start:stop] = weights @ values[:, :, low:high] / weights.sum(-1, keepdims=True)
        return self._out(mixed.transpose(0, 2, 1, 3).reshape(x.shape))

    def _split(self, x: Float[ndarray, "B T W"], parts: int) -> Float[ndarray, "P B H T D"]:
        batch, frames, width = x.shape
        return x.reshape(batch, frames, parts, self._heads, width // parts // self._heads).transpose(2, 0, 3, 1, 4)


def _rotate(x: Float[ndarray, "B H T D"]) -> Float[ndarray, "B H T D"]:
    """Rotary positions (Su et al. 2021), the first frame at position 0."""
    frames, width = x.shape[2:]
    frequencies = (1.0 / ROTARY_BASE ** (np.arange(0, width, 2) / width)).astype(np.float32)
    angle = np.arange(frames, dtype=np.float32)[:, None] * frequencies
    cosine, sine, even, odd = np.cos(angle), np.sin(angle), x[..., 0::2], x[..., 1::2]
    return np.stack([even * cosine - odd * sine, even * sine + odd * cosine], axis=-1).reshape(x.shape)
