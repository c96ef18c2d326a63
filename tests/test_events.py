"""Gaze as fixations and head motion as segments: rendering and detection are consistent, with realistic dynamics."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from test_gaze_point_process import render_row

from talkingeyes.models.gaze.point_process import cyclopean_and_vergence, saccade_landings
from talkingeyes.models.head.point_process import interpolate_poses, speed_minima
from talkingeyes.physiology import saccades

FPS = 25.0


@given(seed=st.integers(0, 10_000))
def test_rendered_fixations_are_detected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    onsets = np.concatenate([[0.0], np.cumsum(rng.integers(8, 20, size=8))])
    locations = np.concatenate([rng.uniform(-0.2, 0.2, (9, 2)), np.full((9, 1), 0.03)], axis=1)
    signal = render_row(onsets / FPS, locations, np.arange(200) / FPS)
    found = saccade_landings(cyclopean_and_vergence(torch.from_numpy(signal[None])))
    at = np.flatnonzero(found.onset[0].numpy())
    amplitudes = np.linalg.norm(np.diff(locations[:, :2], axis=0), axis=1)
    for onset, location, amplitude in zip(onsets[1:], locations[1:], amplitudes, strict=True):
        near = at[np.abs(at - onset) <= 1]
        if amplitude > np.radians(1.5):
            assert len(near) == 1
            np.testing.assert_allclose(found.landing[0, near[0]].numpy(), location, atol=np.radians(0.2))


@pytest.mark.parametrize("fps", [25.0, 120.0])
def test_rendered_saccades_keep_the_main_sequence(fps: float) -> None:
    """At 120 fps the peak speed is that of the main sequence; at 25 fps steps between frames show a part of it."""
    for degrees in (2.0, 5.0, 10.0, 20.0):
        amplitude = np.radians(degrees)
        locations = np.array([[0.0, 0.0, 0.0], [amplitude, 0.0, 0.0]])
        times = np.arange(0, 1, 1 / fps)
        eye = render_row(np.array([0.0, 0.5]), locations, times)[:, 0]
        peak = np.abs(np.diff(eye)).max() * fps
        law = float(saccades.peak_speed(amplitude))
        assert eye[-1] == pytest.approx(amplitude)
        assert peak <= law * 1.001
        if fps == 120.0:
            assert peak > 0.85 * law


def test_a_saccade_waits_for_the_one_before() -> None:
    locations = np.array([[0.0, 0.0, 0.02], [0.3, 0.0, 0.02], [-0.3, 0.0, 0.03]])
    signal = render_row(np.array([0.0, 0.5, 0.51]), locations, np.arange(0, 1, 0.002))
    assert signal[:, 0].max() > 0.3  # it reaches the target before the next saccade
    np.testing.assert_allclose(signal[-1], [-0.27, 0.0, -0.33, 0.0], atol=1e-9)
    assert np.abs(np.diff(signal[:, 0])).max() < 0.05  # and has no jumps


def test_segments_reconstruct_a_smooth_head() -> None:
    """Poses at speed minima with cubic interpolation preserve a sum of waves (error for fitted heads: 0.4 degrees)."""
    times = np.arange(500) / FPS
    rng = np.random.default_rng(0)
    waves = [(rng.uniform(0.02, 0.06, 3), rng.uniform(0.2, 0.9, 3), rng.uniform(0, 6, 3)) for _ in range(3)]
    head = sum(size * np.sin(2 * np.pi * rate * times[:, None] + phase) for size, rate, phase in waves)
    knots = speed_minima(torch.from_numpy(head[None]))[0].numpy()
    knots[[0, -1]] = True
    assert 1 < knots.sum() * FPS / len(head) < 8
    made = interpolate_poses(knots[None], head[None], 1)[0]
    np.testing.assert_allclose(made[knots], head[knots], atol=1e-9)
    assert np.abs(made - head).mean() < 0.3 * head.std()


def test_heads_are_independent_of_batch() -> None:
    """It also starts and ends at rest, at the first and the last pose, even after a long hold."""
    rng = np.random.default_rng(1)
    event, location = rng.random((3, 40)) < 0.3, rng.normal(size=(3, 40, 3))
    event[:, 0], event[2, 1:] = True, False
    since = np.maximum.accumulate(np.where(event, np.arange(40), 0), axis=1)
    location = np.take_along_axis(location, since[..., None], axis=1)
    made = interpolate_poses(event, location, 2)
    assert made.shape == (3, 80, 3)
    for row, one in enumerate(made):
        np.testing.assert_allclose(
            one, interpolate_poses(event[row : row + 1], location[row : row + 1], 2)[0], atol=1e-9
        )
        np.testing.assert_allclose(one[[0, -1]], location[row, [0, -1]], atol=1e-9)
    np.testing.assert_allclose(made[2], np.tile(location[2, 0], (80, 1)))
