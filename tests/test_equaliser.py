"""The equaliser, which gives sampled motion the spectrum of true motion."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray
from scipy.signal import lfilter, welch

from talkingeyes.models.layers.equaliser import Equaliser


def swaying(pole: float, seed: int, clips: int = 24, frames: int = 250) -> list[Float[ndarray, "T 2"]]:
    """Noise through a one-pole filter; a pole nearer to 1 gives slower motion."""
    rng = np.random.default_rng(seed)
    return [lfilter([1.0], [1.0, -pole], rng.standard_normal((frames, 2)), axis=0) for _ in range(clips)]


def power(motions: list[Float[ndarray, "T 2"]]) -> Float[ndarray, " F"]:
    return np.asarray(np.mean([welch(each, nperseg=64, axis=0)[1].mean(axis=1) for each in motions], axis=0))


def test_sampled_motion_gets_the_spectrum_of_true_motion() -> None:
    true, drawn = swaying(0.8, 0), swaying(0.2, 1)
    equaliser = Equaliser(65)
    equaliser.fit(true, drawn)
    fresh = swaying(0.2, 2)
    made = [equaliser(each[None])[0] for each in fresh]
    before, after = (np.abs(np.log(power(each) / power(true)))[1:].mean() for each in (fresh, made))
    assert before > 5 * after, (before, after)
    assert after < 0.15, after


def test_unfitted_equaliser_is_the_identity() -> None:
    equaliser = Equaliser(33)
    motion = np.stack(swaying(0.8, 3, clips=2))
    np.testing.assert_allclose(equaliser(motion), motion, atol=1e-9)
    equaliser.fit(swaying(0.9, 0), swaying(0.5, 1))
    assert np.abs(equaliser(motion) - motion).max() > 0.1
    np.testing.assert_allclose(equaliser(np.full((1, 40, 2), 3.0)), 3.0, atol=1e-9)  # a constant pose is unchanged
    equaliser.reset()
    np.testing.assert_allclose(equaliser(motion), motion, atol=1e-9)


def test_equaliser_is_independent_of_batch_and_zero_phase() -> None:
    equaliser = Equaliser(33)
    equaliser.fit(swaying(0.9, 0), swaying(0.5, 1))
    motion = np.stack(swaying(0.8, 3, clips=4))
    np.testing.assert_array_equal(equaliser(motion)[2], equaliser(motion[2:3])[0])
    np.testing.assert_allclose(equaliser(motion[:, ::-1])[:, ::-1], equaliser(motion), atol=1e-9)


@pytest.mark.parametrize("frames", [0, 33])
def test_equaliser_ignores_short_motion(frames: int) -> None:
    equaliser = Equaliser(frames)
    equaliser.fit(swaying(0.9, 0, frames=10), swaying(0.5, 1, frames=10))
    motion = np.stack(swaying(0.8, 3, clips=2))
    np.testing.assert_allclose(equaliser(motion), motion, atol=1e-9)
