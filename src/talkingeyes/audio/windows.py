"""Encoding of long sound in windows, cross-faded onto motion frames, with constant memory.

A sound up to `window_s` is one window. A longer one is cut into windows of exactly that length (the last one ends with
the sound), so features of long speech resemble those of training clips. Overlapping windows are cross-faded linearly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE, frame_count


@dataclass(frozen=True)
class FrameGrid:
    """Frame positions of an encoder, in samples: step, position of the first frame, and receptive field."""

    samples: int
    first: float
    receptive_field: int

    @classmethod
    def of_convolutions(cls, kernels: tuple[int, ...], strides: tuple[int, ...]) -> FrameGrid:
        """The grid of a stack of convolutions without padding."""
        step, field = 1, 1
        for kernel, stride in zip(kernels, strides, strict=True):
            field += (kernel - 1) * step
            step *= stride
        return cls(step, (field - 1) / 2, field)


def encode_in_windows(
    sound: Float[ndarray, " N"],
    fps: float,
    encode: Callable[[Float[ndarray, " W"]], Float[ndarray, "K C"]],
    stride: FrameGrid,
    window_s: float,
    overlap_s: float,
) -> Float[ndarray, "T C"]:
    """Features at the times t / fps, linearly interpolated between the encoder's frames."""
    size = round(window_s * SAMPLE_RATE)
    times = np.arange(frame_count(len(sound), fps)) / fps * SAMPLE_RATE
    sound = np.pad(sound, (0, stride.receptive_field - len(sound))) if len(sound) < stride.receptive_field else sound
    total = np.zeros(len(times), np.float32)
    features: ndarray | None = None
    for start in window_starts(len(sound), size, round(overlap_s * SAMPLE_RATE)):
        part = sound[start : start + size]
        inside = slice(*np.searchsorted(times, [start, start + len(part)]))
        encoded = interpolate_frames(encode(part), (times[inside] - start - stride.first) / stride.samples)
        weight = crossfade_weight(times[inside] - start, len(part), overlap_s * SAMPLE_RATE)
        features = np.zeros((len(times), encoded.shape[1]), np.float32) if features is None else features
        features[inside] += encoded * weight[:, None]
        total[inside] += weight
    assert features is not None
    features /= total[:, None]
    return np.asarray(features)


def window_starts(length: int, size: int, overlap: int) -> list[int]:
    """First samples of windows that cover the sound; the last window ends where the sound ends."""
    if length <= size:
        return [0]
    return [*range(0, length - size, size - overlap), length - size]


def crossfade_weight(samples: Float[ndarray, " T"], length: int, overlap: float) -> Float[ndarray, " T"]:
    """Weight of a window at given samples of it: 1 inside, falling to almost 0 over the overlap at both ends."""
    nearest_end = np.minimum(samples, length - samples)
    return np.asarray(np.clip((nearest_end + 1) / (overlap + 1), 0, 1), np.float32)


def interpolate_frames(features: Float[ndarray, "K C"], positions: Float[ndarray, " T"]) -> Float[ndarray, "T C"]:
    """Linear interpolation at fractional indices, constant beyond the ends."""
    positions = np.clip(positions, 0, len(features) - 1)
    low = np.minimum(positions.astype(int), max(len(features) - 2, 0))
    high = np.minimum(low + 1, len(features) - 1)
    share = (positions - low)[:, None].astype(np.float32)
    return np.asarray(features[low] * (1 - share) + features[high] * share)
