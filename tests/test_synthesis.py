"""Synthetic data: takes within the reference ranges, weakly coupled to speech, and configured detector noise."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from model_conf import compose

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.physiology.blinks import PAPER, PHYSIOLOGICAL
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.gaze_aversion import PLANNED_PAUSE_S
from talkingeyes.synthesis.speakers import SpeakerStyle, sample_style
from talkingeyes.synthesis.speech_synthesis import synthesize_conversation
from talkingeyes.synthesis.take import Take, sample_take

SETTINGS = plan.SynthesizeSettings(**compose(["synthesize=default"])["synthesize"])
SPEAKERS = 40
FPS = 25.0


@dataclass(frozen=True)
class Played:
    """A take with its inputs."""

    annotation: Annotation
    seconds: float
    style: SpeakerStyle
    take: Take
    motion: Motion


@pytest.fixture(scope="module")
def spoken():
    """Annotations (of the whole conversations) and durations of 40 sounds, one for each speaker."""
    made = []
    for sound in plan.plan_sounds(SETTINGS)[:SPEAKERS]:
        voices = plan.dialogue_voices(SETTINGS, sound)
        made.append(synthesize_conversation(voices, 8.0, 9.6, plan.seeded_generator(0, "sound", sound.index)))
    return [(each.annotation, each.seconds) for each in made]


@pytest.fixture(scope="module")
def played(spoken):
    """Takes of 40 speakers, two sounds each, two takes each."""
    drawn = []
    for number in range(SPEAKERS):
        style = sample_style(plan.seeded_generator(0, "speaker", number))
        for sound in (number, (number + 7) % SPEAKERS):
            annotation, seconds = spoken[sound]
            for take in range(2):
                rng = plan.seeded_generator(0, "motion", 100 * number + sound, take)
                made = sample_take(annotation, style, seconds, rng, PHYSIOLOGICAL)
                drawn.append(Played(annotation, seconds, style, made, made.motion(FPS, round(seconds * FPS))))
    return drawn


def speed_deg_s(angles_rad):
    return np.degrees(np.linalg.norm(np.diff(angles_rad, axis=0), axis=1)) * FPS


def shifts(played):
    """(yaw, pitch) steps of all saccades of at least 1 degree, in degrees."""
    steps = [
        np.subtract(s.end_rad, s.start_rad) for each in played for s in each.take.events.saccades if s.onset_s >= 0
    ]
    steps = np.degrees(steps)
    return steps[np.hypot(*steps.T) >= 1.0]


def averted(each):
    """Mask of frames with averted gaze."""
    times = np.arange(len(each.motion)) / FPS
    return np.any(
        [(times >= look.start_s) & (times < look.end_s) & look.averted for look in each.take.gaze_intervals], axis=0
    )


def speaking(each):
    times = np.arange(len(each.motion)) / FPS
    return np.any([(times >= span.start_s) & (times < span.end_s) for span in each.annotation.speaking], axis=0)


def test_gaze_in_space_is_mostly_still(played):
    space = [rotation.cyclopean_gaze(rotation.gaze_in_space(each.motion.head, each.motion.gaze)) for each in played]
    speed = np.concatenate([speed_deg_s(each) for each in space])
    blinking = np.concatenate([(each.motion.lid > 0.1).any(axis=1)[1:] for each in played])
    assert 0.85 <= (speed[~blinking] < 2.5).mean() <= 0.95


def test_eye_speed_and_spread(played):
    angles = [rotation.gaze_to_angles(each.motion.gaze[:, 0]) for each in played]
    assert 12 <= np.mean([speed_deg_s(each).mean() for each in angles]) <= 20
    yaw, pitch = np.degrees(np.mean([each.std(axis=0) for each in angles], axis=0))
    assert 3 <= yaw <= 8 and 2 <= pitch <= 6
    everything = np.degrees(np.concatenate(angles))
    assert np.abs(everything[:, 0]).max() <= 30 + 1e-6
    assert everything[:, 1].min() >= -30 - 1e-6 and everything[:, 1].max() <= 20 + 1e-6


def test_eyes_converge_move_together_and_have_no_torsion(played):
    converged = []
    for each in played:
        angles = rotation.gaze_to_angles(each.motion.gaze) - np.array(each.style.kappa)
        converged.append(np.degrees(angles[:, 1, 0] - angles[:, 0, 0]).mean())
        assert np.abs(each.motion.gaze[..., 2]).max() < 1e-12
    assert 1.5 <= np.mean(converged) <= 4
    velocity = np.concatenate([np.diff(rotation.gaze_to_angles(e.motion.gaze), axis=0) for e in played])
    assert np.corrcoef(velocity[:, 0, 0], velocity[:, 1, 0])[0, 1] >= 0.97
    assert np.corrcoef(velocity[:, 0, 1], velocity[:, 1, 1])[0, 1] >= 0.99


def test_saccades(played):
    steps = shifts(played)
    amplitude = np.hypot(*steps.T)
    assert 0.8 <= len(steps) / sum(each.seconds for each in played) <= 2.8
    assert 4 <= amplitude.mean() <= 8 and amplitude.max() <= 30
    assert 0.42 <= (amplitude < 5).mean() <= 0.70 and 0.80 <= (amplitude < 15).mean() <= 0.98
    angle = np.degrees(np.arctan2(steps[:, 1], steps[:, 0])) % 90
    cardinal = (angle < 22.5) | (angle > 67.5)
    assert 1.4 <= cardinal.sum() / (~cardinal).sum() <= 3.0


def test_saccades_are_a_chain(played):
    for each in played:
        saccades = each.take.events.saccades
        for before, after in pairwise(saccades):
            assert before.end_rad == after.start_rad
            assert after.onset_s >= before.onset_s + before.duration_s + 0.099


def test_head(played):
    deviation = np.degrees(np.mean([each.motion.head.std(axis=0) for each in played], axis=0))
    assert 2 <= deviation[0] <= 5 and 3 <= deviation[1] <= 6.5 and 1.2 <= deviation[2] <= 4
    speeds = [speed_deg_s(each.motion.head) for each in played]
    assert 5 <= np.mean(np.concatenate(speeds)) <= 18
    talking = np.concatenate([speaking(each)[1:] for each in played])
    speed = np.concatenate(speeds)
    assert 1.3 <= speed[talking].mean() / speed[~talking].mean() <= 3.5


def test_blinks(played):
    blinks = [blink for each in played for blink in each.take.events.blinks]
    assert 18 <= len(blinks) / sum(each.seconds for each in played) * 60 <= 30
    asked = np.mean([each.style.blinks_per_min for each in played])
    assert len(blinks) / sum(each.seconds for each in played) * 60 == pytest.approx(asked, rel=0.2)
    lid = np.concatenate([each.motion.lid for each in played])
    assert lid.max() <= 1.0 and lid.min() >= -0.3 and lid.max() > 0.95


PEAK_S = 0.8  # after the start of an utterance, people avert gaze most


def test_gaze_averts_with_speech_but_weakly(played):
    states = [averted(each) for each in played]
    talking = [1 - state[speaking(each)].mean() for each, state in zip(played, states, strict=True)]
    assert 0.45 <= np.mean(talking) <= 0.70
    starts, ends = [], []
    for each, state in zip(played, states, strict=True):
        for before, after in pairwise(each.annotation.speaking):
            pause = round(before.end_s * FPS), round((after.start_s + PEAK_S) * FPS)
            if after.start_s - before.end_s >= PLANNED_PAUSE_S and pause[0] >= 0 and pause[1] < len(state):
                ends.append(not state[pause[0]])
                starts.append(state[pause[1]])
    assert len(starts) >= 80
    assert 0.35 <= np.mean(starts) <= 0.65 and 0.55 <= np.mean(ends) <= 0.85
    assert np.mean(starts) > 1 - np.mean(talking) + 0.02


def test_speakers_keep_their_habits(played):
    looking = np.array([1 - averted(each).mean() for each in played]).reshape(SPEAKERS, 4).mean(axis=1)
    habits = np.array([each.style.partner_gaze_speaking for each in played]).reshape(SPEAKERS, 4)[:, 0]
    assert np.corrcoef(looking, habits)[0, 1] > 0.6


def test_takes_differ_in_all_but_jaw(played):
    for first, second in zip(played[::2], played[1::2], strict=True):
        assert np.array_equal(first.motion.jaw, second.motion.jaw)
        assert not np.allclose(first.motion.head, second.motion.head, atol=0.01)
    distance = [
        np.linalg.norm((a.motion.gaze - b.motion.gaze).reshape(-1, 6), axis=1).mean()
        for a, b in zip(played[::2], played[1::2], strict=True)
    ]
    assert 0.15 <= np.mean(distance) <= 0.32


def test_the_same_seed_is_the_same_take(spoken):
    annotation, seconds = spoken[0]
    style = sample_style(np.random.default_rng(0))
    first, second = (sample_take(annotation, style, seconds, np.random.default_rng(4), PHYSIOLOGICAL) for _ in range(2))
    assert first.events == second.events
    assert np.array_equal(first.motion(60.0, 500).gaze, second.motion(60.0, 500).gaze)


def test_silence_can_be_synthesised():
    take = sample_take(Annotation(), sample_style(np.random.default_rng(0)), 8.0, np.random.default_rng(1), PAPER)
    motion = take.motion(25.0, 200)
    assert np.array_equal(motion.jaw, np.zeros((200, 3))) and len(take.gaze_intervals) > 0
