"""Windows of long sound, with an encoder of known output: the mean time of its receptive field."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from talkingeyes.audio.windows import FrameGrid, encode_in_windows, window_starts

STRIDE = FrameGrid.of_convolutions((127, 7, 3), (64, 3, 2))


def hear(sound: np.ndarray) -> np.ndarray:
    """Encoder that returns the mean over each receptive field."""
    starts = np.arange(0, len(sound) - STRIDE.receptive_field + 1, STRIDE.samples)
    return np.stack([sound[start : start + STRIDE.receptive_field].mean() for start in starts])[:, None].astype(
        np.float32
    )


def test_stride_of_the_packaged_encoder() -> None:
    assert (STRIDE.samples, STRIDE.first, STRIDE.receptive_field) == (384, 447, 895)


def test_stride_of_wav2vec2() -> None:
    stride = FrameGrid.of_convolutions((10, 3, 3, 3, 3, 2, 2), (5, 2, 2, 2, 2, 2, 2))
    assert (stride.samples, stride.receptive_field) == (320, 400)


@pytest.mark.parametrize("fps", [25.0, 29.97, 120.0])
@pytest.mark.parametrize("seconds", [0.3, 5.0, 9.999, 10.0, 10.1, 17.3, 60.0])
def test_a_ramp_in_time_comes_back_at_frame_times(fps: float, seconds: float) -> None:
    """Windows, cross-fades and interpolation are linear, so the result is exact away from the ends of windows."""
    times_s = np.arange(round(seconds * 16_000)) / 16_000
    heard = encode_in_windows(times_s, fps, hear, STRIDE, 10.0, 2.0)[:, 0]
    expected = np.arange(len(heard)) / fps
    inner = (expected > 0.03) & (expected < seconds - 0.06)
    np.testing.assert_allclose(heard[inner], expected[inner], atol=0.02)
    np.testing.assert_allclose(heard, expected, atol=0.08)


@given(length=st.integers(1, 10_000), size=st.integers(100, 1000), overlap=st.integers(0, 99))
def test_windows_cover_everything_and_overlap_enough(length: int, size: int, overlap: int) -> None:
    starts = window_starts(length, size, overlap)
    assert starts[0] == 0
    assert starts[-1] + size >= length
    assert all(0 < after - before <= size - overlap for before, after in itertools.pairwise(starts))
    assert len(starts) == 1 or starts[-1] + size == length
