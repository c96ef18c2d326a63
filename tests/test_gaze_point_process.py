"""Gaze as fixations, bin by bin: streaming equals sampling and rendering the whole."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy import ndarray

from talkingeyes.core.rotation import angles_to_gaze, gaze_to_angles
from talkingeyes.models.gaze.generator import GazeCondition, StreamableGazeGenerator
from talkingeyes.models.gaze.point_process import (
    PointProcessGaze,
    PointProcessGazeSettings,
    SaccadeSequence,
    render_saccades,
)
from talkingeyes.physiology import eye_head

PROCESS = {
    "width": 16,
    "bin_frames": 2,
    "absolute_components": 4,
    "relative_components": 2,
    "adaptive_components": False,
    "previous_steps": 0,
    "previous_locations": 2,
    "layers": 2,
    "dropout": 0.0,
    "history_dropout": 0.0,
    "history_noise": 0.0,
}


def render_row(onsets_s: ndarray, locations: ndarray, times_s: ndarray) -> ndarray:
    """Gaze rendered from locations and their onsets."""
    return render_saccades(np.ones((1, len(onsets_s)), bool), onsets_s[None], locations[None], times_s)[0]


def crowded() -> tuple[ndarray, ndarray]:
    """Onsets every 50 ms and large steps: most saccades have to wait for the previous one."""
    rng = np.random.default_rng(0)
    onsets_s = np.concatenate([[0.0], 0.2 + 0.05 * np.arange(30)])
    return onsets_s, rng.uniform(-0.4, 0.4, (31, 3)) * [1.0, 0.5, 0.1]


def test_past_saccades_can_be_discarded() -> None:
    onsets_s, locations = crowded()
    times_s = np.arange(0, 4, 0.04)
    chain, parts, most, at = SaccadeSequence(locations[0]), [], 0, 1
    for frames in times_s.reshape(-1, 2):
        while at < len(onsets_s) and onsets_s[at] < frames[0] + 0.08:
            chain.add_saccades(onsets_s[at : at + 1], locations[at : at + 1])
            at += 1
        parts.append(chain.at(frames))
        chain.discard_before(frames[-1])
        most = max(most, len(chain))
    np.testing.assert_allclose(np.concatenate(parts), render_row(onsets_s, locations, times_s), atol=1e-12)
    assert len(chain) == 1
    assert most < 25


def gaze(time: float = 1.0, location: float = 1.0, **changes: object) -> PointProcessGaze:
    torch.manual_seed(0)
    settings = PointProcessGazeSettings.model_validate(
        {
            "kind": "point_process",
            "fps": 25,
            "guidance": {"time": time, "location": location},
            "observation_noise_deg": 0.9,
            "process": PROCESS | changes,
        }
    )
    made = PointProcessGaze(settings, 8, None).eval()
    made.normalise_by(torch.zeros(6), 0.2)
    with torch.no_grad():
        made.process.hazard.bias.fill_(0.5)  # high, so that saccades extend over bins and wait
    return made


def condition(frames: int) -> GazeCondition:
    torch.manual_seed(1)
    head = 0.1 * torch.randn(1, frames, 3)
    return GazeCondition(torch.randn(1, frames, 8), head, head / 0.1, torch.randn(1, frames, 8))


@pytest.mark.parametrize(("frames", "factor"), [(1, 1.0), (2, 1.0), (101, 1.0), (101, 2.0)])
def test_stream_equals_samples_of_the_whole(frames: int, factor: float) -> None:
    made, given = gaze(factor, factor + 0.5 * (factor > 1), lookahead=0), condition(frames)
    expected = made.sample(given, [7], 1.0)
    streaming, parts = made.streaming(1.0), []
    states = [streaming.begin(7)]
    with torch.no_grad():
        for first in range(0, frames, made.step_frames):
            now = slice(first, first + made.step_frames)
            whole = (given.speech, given.head, given.normalised_head, given.mean_speech)
            part, states = streaming.step(states, GazeCondition(*(each[:, now] for each in whole)))
            parts.append(part)
    torch.testing.assert_close(torch.cat(parts, dim=1), expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize("lookahead", [0, 3])
def test_causal_process_has_limited_lookahead(lookahead: int) -> None:
    made, given = gaze(lookahead=lookahead), condition(60)
    assert isinstance(made, StreamableGazeGenerator)
    assert made.has_lookahead == (lookahead > 0)
    before = made.process.condition_encoder(made.binned_condition(given))
    given.speech[:, 40:] += 3
    moved = (made.process.condition_encoder(made.binned_condition(given)) - before)[0].abs().amax(-1) > 1e-6
    assert int(moved.nonzero()[0]) == 20 - lookahead
    assert gaze().has_lookahead  # the default uses past and future speech


def test_eyes_stay_within_range() -> None:
    made, given = gaze(), condition(200)
    far = GazeCondition(given.speech, given.head + torch.tensor([0.3, 0.6, 0.0]), given.normalised_head)
    angles = gaze_to_angles(made.sample(far, [7], 1.0).numpy())
    held = eye_head.clamp_angles(angles)
    np.testing.assert_allclose(angles, held, atol=1e-5)
    assert (np.abs(angles[..., 0]) > eye_head.YAW_LIMIT_RAD - 1e-5).any(), "the head is turned too far away"
    near = angles_to_gaze(np.radians([[29.0, 0.0], [0.0, -29.0], [10.0, 19.0]]))
    np.testing.assert_allclose(eye_head.clamp_to_eye_range(near), near, atol=1e-12)
