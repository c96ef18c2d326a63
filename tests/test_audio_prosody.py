"""Energy and F0 of sounds with known energy and F0."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from talkingeyes.audio.prosody import ProsodySettings, prosody

SETTINGS = ProsodySettings(f0_min_hz=60, f0_max_hz=450, yin_threshold=0.25, energy_window_s=0.05, energy_floor_dbfs=-80)


def voice(f0_hz: np.ndarray) -> np.ndarray:
    """A buzz of 12 harmonics below 4 kHz with the given F0 at each sample."""
    phase = 2 * np.pi * np.cumsum(f0_hz) / 16_000
    return np.asarray(sum(np.sin(k * phase) / k for k in range(1, 9)) * 0.1, np.float32)


@settings(max_examples=25, deadline=None)
@given(
    f0_hz=st.floats(75, 400),
    fps=st.sampled_from([24.0, 25.0, 29.97, 100.0, 240.0]),
    noise=st.floats(0, 0.02),
)
def test_a_steady_voice_has_its_pitch(f0_hz: float, fps: float, noise: float) -> None:
    sound = voice(np.full(8000, f0_hz)) + noise * np.random.default_rng(0).standard_normal(8000).astype(np.float32)
    measured = prosody(sound, fps, SETTINGS)
    inner = slice(int(0.05 * fps) + 1, int(0.45 * fps))
    np.testing.assert_allclose(measured.f0_hz[inner], f0_hz, rtol=0.02)
    assert (measured.voicing[inner] > 0.7).all()


def test_a_glide_is_followed_at_its_own_times() -> None:
    times_s = np.arange(32_000) / 16_000
    f0_hz = 100 * 2 ** (times_s / 2)
    measured = prosody(voice(f0_hz), 50.0, SETTINGS)
    expected = 100 * 2 ** (np.arange(100) / 50 / 2)
    np.testing.assert_allclose(measured.f0_hz[4:95], expected[4:95], rtol=0.01)


@pytest.mark.parametrize("level", [0.0, 0.003, 0.1])
def test_noise_and_silence_have_no_pitch(level: float) -> None:
    noise = (level * np.random.default_rng(1).standard_normal(32_000)).astype(np.float32)
    measured = prosody(noise, 25.0, SETTINGS)
    assert np.isnan(measured.f0_hz).mean() > 0.95
    assert measured.voicing.mean() < 0.4


def test_energy_is_the_level_at_the_frame_and_has_a_floor() -> None:
    sound = np.zeros(32_000, np.float32)
    sound[16_000:] = 0.5 * np.sin(2 * np.pi * 200 * np.arange(16_000) / 16_000)
    measured = prosody(sound, 25.0, SETTINGS)
    assert (measured.energy_dbfs[:24] == -80).all()
    np.testing.assert_allclose(measured.energy_dbfs[27:48], 20 * np.log10(0.5 / np.sqrt(2)), atol=0.2)
    assert -80 < measured.energy_dbfs[25] < measured.energy_dbfs[27]


def test_blocks_have_no_seams() -> None:
    """30 s are 3,000 steps of 10 ms, more than a block; the second half alone gives the same except near its ends."""
    rng = np.random.default_rng(2)
    f0_hz = 150 + 50 * np.sin(np.arange(480_000) / 16_000)
    sound = voice(f0_hz) * np.repeat(rng.uniform(0, 1, 300), 1600).astype(np.float32)
    whole = prosody(sound, 100.0, SETTINGS)
    half = prosody(sound[240_000:], 100.0, SETTINGS)
    for name in ("energy_dbfs", "f0_hz", "voicing"):
        np.testing.assert_allclose(getattr(whole, name)[1510:2990], getattr(half, name)[10:1490], rtol=1e-3, atol=1e-3)
