"""Conversion of frames to events and back: saccades are detected and rendered at any frame rate; blinks hold gaze."""

from typing import Any

import numpy as np
import pytest

from talkingeyes.animation.animator import Animator
from talkingeyes.animation.blink_sampling import shut_frames
from talkingeyes.animation.controls import Controls
from talkingeyes.animation.gaze_trajectory import hold_frames
from talkingeyes.animation.saccade_resampling import resample
from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import gaze_in_space_speed_deg_s
from talkingeyes.core.motion import Blink, Saccade
from talkingeyes.corpus.samples import Samples
from talkingeyes.physiology import saccades
from talkingeyes.physiology.frame_saccades import find_saccades
from talkingeyes.training.motion_generators import Speech, TrainedGenerator


def scene(onsets_s: list[float], amplitude_deg: float, fps: float, seconds: float = 4.0) -> tuple[Any, Any]:
    """Saccades back and forth, point-sampled at `fps`, with the duration and skew of the main sequence."""
    amplitude = np.radians(amplitude_deg)
    ends = [(amplitude if index % 2 == 0 else 0.0, 0.0) for index in range(len(onsets_s))]
    starts = [(0.0, 0.0), *ends[:-1]]
    law = float(saccades.duration_s(amplitude)), float(saccades.skew(amplitude))
    true = [Saccade(o, law[0], s, e, law[1]) for o, s, e in zip(onsets_s, starts, ends, strict=True)]
    return true, saccades.gaze_path(true, (0.0, 0.0), np.arange(int(seconds * fps)) / fps)


@pytest.mark.parametrize("amplitude_deg", [3.0, 8.0, 20.0])
def test_saccades_are_found_with_onset_and_amplitude(amplitude_deg: float) -> None:
    onsets = [0.513, 1.294, 2.01, 3.377]
    true, space = scene(onsets, amplitude_deg, 25.0)
    found = find_saccades(space, 25.0)
    assert len(found) == len(true)
    for one, other in zip(found, true, strict=True):
        assert abs(one.onset_s - other.onset_s) < 0.021
        np.testing.assert_allclose(one.end_rad, other.end_rad, atol=np.radians(0.3))


def test_drift_before_a_saccade_does_not_make_it_early() -> None:
    """Eyes at the limit of their range are carried by the head, not much slower than a saccade."""
    times = np.arange(50) / 25.0
    jump = saccades.sample_saccade(1.0, np.zeros(2), np.radians([24.0, 7.0]), np.random.default_rng(0))
    drift = np.radians(0.3) * 25.0 * np.clip(times - 0.7, 0.0, 0.3)
    space = saccades.gaze_path((jump,), jump.start_rad, times) + drift[:, None] * [1.0, 0.0]
    (found,) = find_saccades(space, 25.0)
    assert found.onset_s == pytest.approx(jump.onset_s, abs=0.012)


def test_a_saccade_that_turns_back_is_two() -> None:
    """As one, its amplitude would be the small difference, and no limit of amplitudes would see the large one."""
    yaw = np.radians([20.0, 20.0, 2.0, -12.0, -13.0, -4.0, -4.0])
    gaze = np.stack([yaw, np.zeros(7)], axis=-1)
    (net,) = find_saccades(gaze, 25.0)
    there, back = find_saccades(gaze, 25.0, split_turns=True)
    assert net.start_rad[0] - net.end_rad[0] == pytest.approx(np.radians(24.0))
    assert there.start_rad[0] - there.end_rad[0] == pytest.approx(np.radians(33.0))
    assert back.end_rad[0] - back.start_rad[0] == pytest.approx(np.radians(9.0))
    assert back.onset_s >= 4 / 25.0


@pytest.mark.parametrize("amplitude_deg", [5.0, 10.0, 20.0])
def test_resampled_saccades_keep_the_main_sequence_and_linear_ones_do_not(amplitude_deg: float) -> None:
    _, space = scene([0.513, 1.294, 2.01, 3.377], amplitude_deg, 25.0)
    both = np.repeat(space[:, None], 2, axis=1)
    head = np.zeros((len(space), 3))
    at_120 = resample(head, both, find_saccades(space, 25.0), 25.0, 120.0)
    assert len(at_120.head) == len(space) * 120 // 25
    law = np.degrees(saccades.peak_speed(np.radians(amplitude_deg)))
    peak = gaze_in_space_speed_deg_s(at_120.head, at_120.gaze, 120.0).max()
    assert 0.85 * law < peak < 1.1 * law
    linear = np.degrees(np.abs(np.diff(space[:, 0])).max() * 25)
    assert linear < 0.95 * peak


def test_one_frame_can_be_resampled() -> None:
    out = resample(np.zeros((1, 3)), np.zeros((1, 2, 2)), (), 25.0, 100.0)
    assert out.head.shape == (4, 3)


def test_gaze_is_held_while_the_lids_are_shut() -> None:
    space = np.arange(50.0)[:, None, None] * np.ones((1, 2, 2))
    shut = shut_frames([Blink(0.5, 0.08, 0.08, 0.1, 1.0)], np.arange(50) / 25.0)
    held = hold_frames(space, shut)[:, 0, 0]
    steps = np.diff(held)
    assert 2 <= (steps == 0).sum() <= 6
    assert held[-1] == 49
    assert (held <= space[:, 0, 0]).all()
    np.testing.assert_array_equal(hold_frames(space, shut_frames([], np.arange(50) / 25.0)), space)


class FakeEncoder:
    channels = ("a",)

    def __call__(self, sound: Any, fps: float) -> Any:
        return np.zeros((int(len(sound) * fps // 16_000), 1), np.float32)


class FakeGenerator(TrainedGenerator):
    def sample(self, speech: Speech) -> Samples:
        frames = len(speech.embedding)
        walks = [np.random.default_rng(seed).normal(0, 0.01, (frames, 3)).cumsum(0) * 0.1 for seed in speech.seeds]
        head = np.stack(walks)
        return Samples(speech.fps, head, np.zeros((len(walks), frames, 2, 3)))


PERFORMER = Animator(FakeEncoder(), FakeGenerator(), 25.0)
SOUND = np.zeros(16_000 * 20, np.float32)


def test_animation_has_blinks_and_requested_rate() -> None:
    (slow,), (fast,) = (PERFORMER.perform(SOUND, 1, seed=3, fps=fps) for fps in (25.0, 60.0))
    assert len(slow.motion) == 500
    assert len(fast.motion) == 1200
    assert slow.events == fast.events
    assert 1 <= len(slow.events.blinks) <= 20
    assert fast.motion.lid.max() > 0.8
    np.testing.assert_allclose(fast.motion.head[::12], slow.motion.head[::5], atol=1e-6)


def test_profiles_blink_at_their_rates() -> None:
    long = np.zeros(16_000 * 120, np.float32)
    rates = {}
    for profile in ("paper", "physiological"):
        made = PERFORMER.perform(long, 30, seed=1, fps=25.0, controls=Controls(blinks=profile))
        rates[profile] = np.mean([len(one.events.blinks) / 2 for one in made])
    assert 34 < rates["paper"] < 46
    assert 18 < rates["physiological"] < 30


def test_blinks_follow_phrase_ends_except_in_profile_paper() -> None:
    """Sound alternates two seconds of noise and one of silence; `late` counts blinks near the onset of silence."""
    at_s = np.arange(16_000 * 120) / 16_000
    sound = np.where(at_s % 3 < 2, 0.1, 1e-4) * np.random.default_rng(0).standard_normal(len(at_s))
    late = {}
    for profile in ("paper", "physiological"):
        made = PERFORMER.perform(sound.astype(np.float32), 20, seed=1, fps=25.0, controls=Controls(blinks=profile))
        onsets_s = np.array([blink.onset_s for one in made for blink in one.events.blinks]) % 3
        late[profile] = np.mean((onsets_s >= 1.9) & (onsets_s < 2.5)) / (0.6 / 3)
    assert late["physiological"] > 1.5
    assert 0.8 < late["paper"] < 1.2
    made = PERFORMER.generate_from_embedding(np.zeros((3000, 1), np.float32), 20, seed=1, fps=25.0)
    onsets_s = np.array([blink.onset_s for one in made for blink in one.events.blinks]) % 3
    assert 0.8 < np.mean((onsets_s >= 1.9) & (onsets_s < 2.5)) / (0.6 / 3) < 1.2, "nobody knows when it speaks"


def test_unknown_profile_is_one_line_error() -> None:
    with pytest.raises(InputError, match="one of paper, physiological, got often"):
        PERFORMER.perform(SOUND, 1, 0, 25.0, Controls(blinks="often"))
