"""Drawn motion is given the spectrum of true motion: a linear filter without delay, learnt when all else is trained.

What a network draws freely differs from what it was taught by: each draw depends on earlier draws, not on the truth,
and a rhythm of the truth's blurs. How much too much or too little there is at each frequency is read off motion drawn
for the speech of the train split (Welch 1967), and a filter of one gain a frequency makes up for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from scipy.signal import oaconvolve, welch
from scipy.signal.windows import hann
from torch import Tensor, nn

MAX_GAIN = 3.0
MIN_FRAMES = 16  # shorter motion has no spectrum to speak of


class Equaliser(nn.Module):
    """A filter over an odd number of frames, the same for all numbers of a frame; 0: none. At first it does nothing."""

    taps: Tensor

    def __init__(self, frames: int) -> None:
        super().__init__()
        self.register_buffer("taps", torch.zeros(frames, dtype=torch.float64))
        self.reset()

    def reset(self) -> None:
        """Do nothing again."""
        self.taps.copy_(torch.arange(len(self.taps)) == len(self.taps) // 2)

    def match(self, true: Sequence[Float[ndarray, "_ D"]], sampled: Sequence[Float[ndarray, "_ D"]]) -> None:
        """Learn the filter that gives motion drawn without it the spectrum of true motion of the same lengths."""
        if not len(self.taps) or not any(len(each) >= MIN_FRAMES for each in true):
            return
        gain = np.sqrt(self._power(true) / self._power(sampled)).clip(1 / MAX_GAIN, MAX_GAIN)
        gain[0] = 1.0  # spectra are those of deviations from a clip's mean, which stays, whatever the window blurs
        window = hann(len(self.taps) + 2)[1:-1]
        taps = np.fft.fftshift(np.fft.irfft(gain, len(self.taps))) * window
        taps += (1.0 - taps.sum()) * window / window.sum()
        self.taps.copy_(torch.from_numpy(taps))

    def _power(self, motions: Sequence[Float[ndarray, "_ D"]]) -> Float[ndarray, " F"]:
        """Mean over frames and numbers."""
        count = len(self.taps)
        long = [each for each in motions if len(each) >= MIN_FRAMES]
        spectra = [welch(each, nperseg=min(len(each), count), nfft=count, axis=0)[1].mean(axis=1) for each in long]
        return np.asarray(np.average(spectra, axis=0, weights=[len(each) for each in long]))

    def forward(self, motion: Float[ndarray, "B T D"]) -> Float[ndarray, "B T D"]:
        """The same motion with another spectrum; before its beginning and after its end it is still."""
        if not len(self.taps):
            return motion
        half = len(self.taps) // 2
        still = np.pad(motion, ((0, 0), (half, half), (0, 0)), mode="edge")
        return np.asarray(oaconvolve(still, self.taps.cpu().numpy()[None, :, None], mode="valid", axes=1))
