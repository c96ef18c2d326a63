"""Zero-phase linear filter that gives sampled motion the spectrum of true motion. It is fitted after training.

Free-running samples differ from the training data: each sample depends on earlier samples instead of the truth, and
rhythms of the truth are blurred. The gain at each frequency is the ratio of the spectra (Welch 1967) of true motion and
of motion sampled for the speech of the train split.
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
MIN_FRAMES = 16  # shorter motions are excluded from the spectra


class Equaliser(nn.Module):
    """A filter of an odd number of taps, the same for all dimensions; 0: none. The initial filter is the identity."""

    taps: Tensor

    def __init__(self, frames: int) -> None:
        super().__init__()
        self.register_buffer("taps", torch.zeros(frames, dtype=torch.float64))
        self.reset()

    def reset(self) -> None:
        """Reset to the identity."""
        self.taps.copy_(torch.arange(len(self.taps)) == len(self.taps) // 2)

    def fit(self, true: Sequence[Float[ndarray, "_ D"]], sampled: Sequence[Float[ndarray, "_ D"]]) -> None:
        """Fit the filter that gives motion sampled without it the spectrum of true motion of the same lengths."""
        if not len(self.taps) or not any(len(each) >= MIN_FRAMES for each in true):
            return
        gain = np.sqrt(self._power(true) / self._power(sampled)).clip(1 / MAX_GAIN, MAX_GAIN)
        gain[0] = 1.0  # the mean of a clip is kept: spectra are of deviations from it
        window = hann(len(self.taps) + 2)[1:-1]
        taps = np.fft.fftshift(np.fft.irfft(gain, len(self.taps))) * window
        taps += (1.0 - taps.sum()) * window / window.sum()
        self.taps.copy_(torch.from_numpy(taps))

    def _power(self, motions: Sequence[Float[ndarray, "_ D"]]) -> Float[ndarray, " F"]:
        """Mean power spectrum over clips (weighted by length) and dimensions."""
        count = len(self.taps)
        long = [each for each in motions if len(each) >= MIN_FRAMES]
        spectra = [welch(each, nperseg=min(len(each), count), nfft=count, axis=0)[1].mean(axis=1) for each in long]
        return np.asarray(np.average(spectra, axis=0, weights=[len(each) for each in long]))

    def forward(self, motion: Float[ndarray, "B T D"]) -> Float[ndarray, "B T D"]:
        """Filter a motion. It is padded by its first and last frame."""
        if not len(self.taps):
            return motion
        half = len(self.taps) // 2
        still = np.pad(motion, ((0, 0), (half, half), (0, 0)), mode="edge")
        return np.asarray(oaconvolve(still, self.taps.cpu().numpy()[None, :, None], mode="valid", axes=1))
