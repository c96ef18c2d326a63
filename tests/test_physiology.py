"""The models of physiology/: main sequence, sampling, head movements, VOR, blinks, jaw, rendering at any rate."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from talkingeyes.audio.annotation import Annotation, Phoneme, Span
from talkingeyes.core import rotation
from talkingeyes.core.motion import Blink, Events, HeadMovement, Saccade, VergenceMovement
from talkingeyes.head.eyelid.anatomy import EyelidParameters
from talkingeyes.physiology import blinks, eye_head, render, saccades, vergence
from talkingeyes.physiology.articulation import ArticulationStyle
from talkingeyes.physiology.face import BrowRaise, FacialBehaviour


def straight(amplitude_deg, onset_s=0.1, direction=(1.0, 0.0)):
    """A saccade from straight ahead, without jitter."""
    amplitude = np.radians(amplitude_deg)
    end = tuple(float(amplitude * part) for part in direction)
    return Saccade(onset_s, float(saccades.duration_s(amplitude)), (0.0, 0.0), end, float(saccades.skew(amplitude)))


def speeds_deg_s(saccade, fps, shift_s=0.0):
    """Speeds between the samples of one saccade."""
    path = saccades.gaze_path((saccade,), saccade.start_rad, np.arange(0.0, 0.6, 1.0 / fps) + shift_s)
    return np.degrees(np.linalg.norm(np.diff(path, axis=0), axis=1)) * fps


@pytest.mark.parametrize(
    ("amplitude_deg", "peak_deg_s"), [(1, 64), (2, 116), (5, 226), (10, 329), (20, 435), (30, 497)]
)
def test_main_sequence(amplitude_deg, peak_deg_s):
    assert speeds_deg_s(straight(amplitude_deg), 2000).max() == pytest.approx(peak_deg_s, rel=0.015)
    assert np.degrees(saccades.peak_speed(np.radians(amplitude_deg))) == pytest.approx(peak_deg_s, rel=0.015)


def test_main_sequence_is_seen_at_500_hz():
    for amplitude_deg, peak_deg_s in [(2, 116), (5, 226), (10, 329)]:
        assert speeds_deg_s(straight(amplitude_deg), 500).max() == pytest.approx(peak_deg_s, rel=0.03)


@pytest.mark.parametrize(("amplitude_deg", "ratio"), [(2, 0.38), (5, 0.47), (10, 0.60), (20, 0.77)])
def test_25_fps_sees_part_of_the_peak(amplitude_deg, ratio):
    saccade = straight(amplitude_deg)
    seen = np.mean([speeds_deg_s(saccade, 25, shift).max() for shift in np.linspace(0, 0.04, 80, endpoint=False)])
    assert seen / speeds_deg_s(saccade, 2000).max() == pytest.approx(ratio, abs=0.04)


@given(st.floats(0.2, 40), st.floats(0, 2 * np.pi), st.floats(0.0, 0.2))
def test_a_saccade_runs_straight_from_start_to_end(amplitude_deg, angle, onset_s):
    saccade = straight(amplitude_deg, onset_s, (np.cos(angle), np.sin(angle)))
    path = saccades.gaze_path((saccade,), saccade.start_rad, np.linspace(0.0, 0.5, 300))
    along = path @ [np.cos(angle), np.sin(angle)]
    assert (np.diff(along) >= 0).all()
    assert np.allclose(path[-1], saccade.end_rad)
    assert np.allclose(saccades.gaze_path((saccade,), saccade.start_rad, np.array([onset_s])), 0.0)


def test_a_chain_holds_between_saccades():
    first = straight(5, 0.1)
    second = Saccade(0.5, 0.04, first.end_rad, (0.0, 0.1), 0.45)
    path = saccades.gaze_path([first, second], (9.0, 9.0), np.array([0.0, 0.3, 0.5, 0.9]))
    assert np.allclose(path, [(0, 0), first.end_rad, first.end_rad, (0, 0.1)])
    assert np.allclose(saccades.gaze_path([], (0.1, 0.2), np.zeros(2)), [(0.1, 0.2)] * 2)


def test_eyes_alive():
    rng = np.random.default_rng(0)
    amplitude = np.degrees(saccades.sample_amplitudes_rad(20_000, rng))
    assert 6.0 < amplitude.mean() < 7.2 and amplitude.max() <= 27.5
    assert (amplitude < 5).mean() == pytest.approx(0.5, abs=0.03)
    least = saccades.sample_amplitudes_rad(1000, rng, min_deg=4.0, max_deg=8.0)
    assert np.degrees(least.min()) >= 4.0 and np.degrees(least.max()) <= 8.0
    step = saccades.sample_directions(20_000, rng)
    angle = np.degrees(np.arctan2(step[:, 1] / saccades.VERTICAL_SHRINK, step[:, 0])) % 90
    cardinal = (angle < 22.5) | (angle > 67.5)
    assert cardinal.sum() / (~cardinal).sum() == pytest.approx(2.2, abs=0.3)


def test_sampled_saccades_scatter_about_the_main_sequence():
    rng = np.random.default_rng(0)
    drawn = [saccades.sample_saccade(0.0, np.zeros(2), np.array([0.1, 0.0]), rng) for _ in range(500)]
    logs = np.log([each.duration_s / saccades.duration_s(0.1) for each in drawn])
    assert abs(logs.mean()) < 0.02 and logs.std() == pytest.approx(0.08, abs=0.015)


def test_head_contributes_beyond_its_threshold():
    eccentricity = np.radians([[-30.0, 0.0], [-5.0, 3.0], [0.0, 5.0], [18.0, 24.0]])
    turn = np.degrees(eye_head.head_contribution(eccentricity, np.radians(10.0), 0.5))
    assert np.allclose(turn, [(-10.0, 0.0), (0.0, 0.0), (0.0, 0.0), (6.0, 8.0)])
    move = HeadMovement(0.2, float(eye_head.head_duration_s(np.radians(10.0))), (0.0, float(np.radians(10.0)), 0.0))
    assert move.duration_s == pytest.approx(0.37)
    speed = np.diff(eye_head.head_path([move], np.arange(0, 1, 0.001))[:, 1]) * 1000
    assert np.degrees(speed.max()) == pytest.approx(1.875 * 10 / 0.37, rel=0.01)
    lags = np.array([eye_head.sample_onset_lag_s(np.random.default_rng(i)) for i in range(300)])
    assert 0.01 < np.median(lags) < 0.06


NO_KAPPA = np.zeros((2, 2))


def eye_rotations(head, gaze_in_space_rad, vergence=0.0, kappa=NO_KAPPA, blink=0.0):
    """Eyes of a head with gaze in one direction."""
    frames = len(head)
    blinked = np.full((frames, 2, 2), blink)
    return eye_head.eye_rotations(
        head, np.tile(gaze_in_space_rad, (frames, 1)), np.full(frames, vergence), kappa, blinked
    )


def test_the_eyes_counter_rotate():
    head = np.radians(np.random.default_rng(1).normal(0, 5, (50, 3)))
    gaze = eye_rotations(head, [0.05, -0.03])
    assert np.allclose(rotation.gaze_in_space(head, gaze), [0.05, -0.03], atol=1e-9)
    assert np.allclose(gaze[..., 2], 0.0) and np.allclose(gaze[:, 0], gaze[:, 1])


def test_lines_of_sight_meet_in_the_target():
    half, distance_m = vergence.HALF_INTERPUPILLARY_M, 0.6
    full = 2.0 * np.arctan(half / distance_m)
    assert np.degrees(vergence.vergence_rad(distance_m)) == pytest.approx(0.7 * 6.0, abs=0.02)
    one = rotation.angles_to_direction(np.radians([[20.0, -10.0]]))
    sight = vergence.lines_of_sight(one, np.array([full]))[0]
    centres = np.array([[half, 0.0, 0.0], [-half, 0.0, 0.0]])
    for centre, line in zip(centres, sight, strict=True):
        assert np.allclose(np.cross(distance_m * one[0] - centre, line), 0.0, atol=1e-12)
    converged = rotation.gaze_to_angles(eye_rotations(np.zeros((1, 3)), [0.0, 0.0], full))[0]
    assert converged[1, 0] - converged[0, 0] == pytest.approx(full) and np.allclose(converged[:, 1], 0.0)


def test_vergence_is_slow_and_opens_in_saccades():
    times = np.arange(0.0, 4.0, 0.001)
    near, far = vergence.vergence_rad(0.8), vergence.vergence_rad(3.0)
    path = vergence.vergence_path(
        [VergenceMovement(-1.0, 0.8), VergenceMovement(1.0, 3.0), VergenceMovement(1.4, 0.8)], (), times
    )
    assert path[0] == pytest.approx(near) and np.abs(np.diff(path)).max() < np.radians(0.02)
    assert path[1200] == pytest.approx(far + (near - far) * np.exp(-1.0), rel=1e-3)
    assert path[1400] > far and path[-1] == pytest.approx(near, rel=1e-4)
    opened = vergence.vergence_path((), [straight(10, 1.0)], times)
    assert np.degrees(opened.min()) == pytest.approx(-0.5, abs=0.01) and opened[1200] == 0.0 == opened[1000]
    assert not vergence.saccadic_divergence([straight(10, 1.0, (0.0, 1.0))], times).any()


def test_kappa_is_between_the_line_of_sight_and_the_pupil():
    kappa = np.radians([[4.0, -1.0], [-5.0, -1.5]])
    head = np.radians(np.random.default_rng(2).normal(0, 5, (20, 3)))
    away = rotation.gaze_to_angles(eye_rotations(head, [0.1, 0.0], kappa=kappa)) - rotation.gaze_to_angles(
        eye_rotations(head, [0.1, 0.0])
    )
    assert np.allclose(away, kappa, atol=1e-9)
    assert np.allclose(eye_rotations(head, [0.1, 0.0], kappa=kappa)[..., 2], 0.0)


def test_eyes_turn_down_and_in_during_a_blink():
    shift = np.degrees(blinks.blink_eye_rotation_rad(np.array([[0.0, 0.0], [1.0, 1.0]])))
    assert np.array_equal(shift[0], np.zeros((2, 2)))
    assert shift[1, 0, 0] < 0 < shift[1, 1, 0] and (shift[1, :, 1] < -1.0).all()
    assert 1.0 <= np.hypot(*shift[1, 0]) <= 5.0


@given(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(-0.6, 0.6))
def test_the_eyes_keep_to_their_range(yaw, pitch, head_yaw):
    angles = rotation.gaze_to_angles(
        eye_rotations(np.array([[0.0, head_yaw, 0.0]]), [yaw, pitch], 0.05, kappa=NO_KAPPA + 0.08)
    )
    assert np.abs(angles[..., 0]).max() <= eye_head.YAW_LIMIT_RAD + 1e-9
    assert eye_head.PITCH_LIMITS_RAD[0] - 1e-9 <= angles[..., 1].min()
    assert angles[..., 1].max() <= eye_head.PITCH_LIMITS_RAD[1] + 1e-9


def test_blink_rates_of_the_profiles():
    rng = np.random.default_rng(0)
    paper = np.array([blinks.sample_blink_rate(blinks.PAPER, rng) for _ in range(1000)])
    assert paper.mean() == pytest.approx(40.10, abs=1.5) and paper.std() == pytest.approx(15.42, abs=1.0)
    physio = np.array([blinks.sample_blink_rate(blinks.PHYSIOLOGICAL, rng) for _ in range(500)])
    assert kstest((np.log(physio) - np.log(23)) / 0.35, "norm").pvalue > 0.05
    own = replace(blinks.PHYSIOLOGICAL, distribution="normal", centre_per_min=12.0, spread=1.0)
    assert np.mean([blinks.sample_blink_rate(own, rng) for _ in range(200)]) == pytest.approx(12.0, abs=0.3)


@pytest.mark.parametrize("rate", [6.0, 24.0, 50.0])
@pytest.mark.parametrize("profile", [blinks.PAPER, blinks.PHYSIOLOGICAL])
def test_blinks_come_at_the_rate_asked_for(profile, rate):
    drawn = tuple(blinks.sample_blinks(profile, 3600.0, np.random.default_rng(0), rate_per_min=rate))
    assert len(drawn) / 60 == pytest.approx(rate, rel=0.12)
    intervals = np.diff([blink.onset_s for blink in drawn])
    assert all(blinks.end_s(a) <= b.onset_s for a, b in pairwise(drawn))
    assert profile is blinks.PAPER or rate > 24 or 0.5 < intervals.std() / intervals.mean() < 1.1


def test_blinks_prefer_phrase_ends():
    spans = tuple(Span(start, start + 2.5) for start in np.arange(0.0, 3000.0, 3.0))
    spoken = Annotation(speaking=spans)
    drawn = tuple(blinks.sample_blinks(blinks.PHYSIOLOGICAL, 3000.0, np.random.default_rng(0), spoken, 24.0))
    phase = np.array([blink.onset_s for blink in drawn]) % 3.0
    ends = ((phase > 2.0) & (phase < 3.0)).sum() / 1.0
    middle = ((phase > 0.6) & (phase < 2.0)).sum() / 1.4
    assert 1.5 < ends / middle < 5.0
    assert len(drawn) / 50 == pytest.approx(24.0, rel=0.15)


def test_blink_kinematics():
    rng = np.random.default_rng(0)
    drawn = [blinks.sample_blink(blinks.PHYSIOLOGICAL, 0.0, rng) for _ in range(500)]
    closing, opening = np.mean([b.closing_s for b in drawn]), np.mean([b.opening_s for b in drawn])
    assert 0.06 < closing < 0.12 and 0.15 < opening < 0.32 and 1.3 < opening / closing < 3.0
    assert 0.22 < np.mean([blinks.end_s(b) for b in drawn]) < 0.42
    assert np.mean([b.depth == 1.0 for b in drawn]) == pytest.approx(0.7, abs=0.06)
    window = blinks.sample_blink(blinks.PAPER, 1.0, rng)
    assert blinks.end_s(window) == pytest.approx(1.2)
    assert (
        blinks.evoked_blink_probability(np.radians(4)) == 0.0 < blinks.evoked_blink_probability(np.radians(33)) <= 0.97
    )


@given(st.lists(st.floats(0.0, 9.0), max_size=8), st.integers(0, 1000))
def test_closure_stays_between_open_and_shut(onsets, seed):
    rng = np.random.default_rng(seed)
    drawn = blinks.drop_overlapping([blinks.sample_blink(blinks.PHYSIOLOGICAL, onset, rng) for onset in onsets])
    shut = blinks.blink_closure(drawn, np.linspace(0.0, 10.0, 1001))
    assert (shut >= 0.0).all() and (shut <= 1.0).all()


def test_closure_reaches_the_depth_and_opens_again():
    blink = Blink(1.0, 0.08, 0.03, 0.2, 0.8)
    shut = blinks.blink_closure([blink], np.array([0.99, 1.08, 1.10, 1.32]))
    assert np.allclose(shut, [0.0, 0.8, 0.8, 0.0], atol=1e-9)


@pytest.fixture
def continuous_motion():
    rng = np.random.default_rng(3)
    waves = render.Sinusoids(rng.uniform(0.1, 6, 5), rng.normal(0, 0.01, (5, 3)), rng.uniform(0, 6, (5, 3)))
    return render.ContinuousMotion(
        gaze_rest_rad=(0.0, 0.0),
        kappa_rad=np.radians([[4.0, -1.0], [-5.0, -1.0]]),
        head_rest=np.array([0.02, 0.0, 0.01]),
        head_drift=waves,
        head_speech_motion=waves,
        activity=render.PiecewiseLinear(np.array([0.5, 1.0]), np.array([0.1, 1.0])),
        translation=waves,
        eyelids=(EyelidParameters(), EyelidParameters()),
        lid_rest=0.02,
        lid_drift=render.Sinusoids(np.array([0.3]), np.full((1, 2), 0.02), np.array([[0.0, 1.0]])),
        blink_lag_s=0.006,
        phonemes=(Phoneme(0.2, 0.4, "a", True), Phoneme(0.4, 0.5, "t")),
        mouth=ArticulationStyle(jaw_asymmetry=0.1),
        face=FacialBehaviour("happy", 0.7, (BrowRaise(0.3, 0.2, 0.1, 0.3, 0.5),)),
        emotion_fluctuation=render.Sinusoids(np.array([0.2]), np.full((1, 1), 0.2), np.array([[0.4]])),
    )


EVENTS = Events(
    saccades=(straight(8, 0.313), Saccade(1.0, 0.04, (float(np.radians(8)), 0.0), (0.0, 0.05), 0.45)),
    head_movements=(HeadMovement(0.4, 0.5, (0.0, 0.05, 0.0)),),
    blinks=(Blink(0.6, 0.08, 0.03, 0.2, 1.0),),
    vergence_movements=(VergenceMovement(-1.0, 0.9), VergenceMovement(1.0, 2.5)),
)


def test_motion_is_the_same_at_any_frame_rate(continuous_motion):
    slow = render.render_at(EVENTS, continuous_motion, 25.0, 50)
    fast = render.render_at(EVENTS, continuous_motion, 100.0, 200)
    for name in ("head", "gaze", "lid", "jaw", "expression", "translation"):
        assert np.allclose(getattr(slow, name), getattr(fast, name)[::4], atol=1e-9), name


def test_gaze_is_still_in_space_while_the_head_moves(continuous_motion):
    motion = render.render_at(EVENTS, continuous_motion, 100.0, 200)
    space = rotation.gaze_in_space(motion.head, motion.gaze)[:, 0]
    assert np.abs(np.diff(motion.head[45:95], axis=0)).max() > 1e-4
    assert np.abs(np.diff(space[45:60], axis=0)).max() < np.radians(0.01)
    assert motion.lid.max() == pytest.approx(1.0) and motion.lid.min() > -0.3
