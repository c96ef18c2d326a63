"""Measures of pipelines.real_motion on motion with known figures."""

from __future__ import annotations

import numpy as np
import pytest

from pipelines.real_motion import MEASURES, distances, measure_clip
from talkingeyes.evaluation.benchmark.behaviour import Behaviour, behaviour

FPS = 25.0


def swinging(head_deg: float, eye_deg: float, jitter_deg: float = 0.0) -> Behaviour:
    """Eight seconds of a head that swings once a second in yaw, and of eyes that turn against it."""
    phase = np.sin(2 * np.pi * np.arange(200) / FPS)
    head, gaze = np.zeros((200, 3)), np.zeros((200, 2, 3))
    head[:, 1] = np.radians(head_deg * phase + jitter_deg * (-1.0) ** np.arange(200))
    gaze[:, :, 1] = -np.radians(eye_deg * phase)[:, None]
    return behaviour(FPS, {"head": head, "gaze": gaze}, None)


def measured(motion: Behaviour) -> dict[str, float]:
    return dict(zip((each.title for each in MEASURES), measure_clip(motion), strict=True))


def test_figures_of_a_swing() -> None:
    found = measured(swinging(10.0, 4.0))
    assert found["head yaw, SD, deg"] == pytest.approx(10 / np.sqrt(2), rel=0.01)
    assert found["eye-in-head yaw, SD, deg"] == pytest.approx(4 / np.sqrt(2), rel=0.01)
    assert found["correlation of eye-in-head and head yaw"] == pytest.approx(-1, abs=0.01)
    assert np.isnan(found["blinks per minute"])


def test_jitter_between_frames_hardly_raises_the_speed_of_the_head() -> None:
    name = "head speed over 0.2 s, median, deg/s"
    still, jittering = (measured(swinging(10.0, 4.0, each))[name] for each in (0.0, 0.5))
    assert jittering < 1.2 * still  # between neighbouring frames the jitter alone is 25 degrees per second


def test_the_gain_of_the_eyes_is_free_within_its_range_and_that_of_the_head_is_not() -> None:
    rng = np.random.default_rng(0)
    real = np.tile(rng.uniform(2, 4, 9), (len(MEASURES), 1))
    found = distances(real, 1.3 * real)
    for measure, (as_tracked, at_best) in zip(MEASURES, found, strict=True):
        assert as_tracked > 0.5
        assert at_best == pytest.approx(0.0 if measure.of_eyes else as_tracked, abs=0.05)
