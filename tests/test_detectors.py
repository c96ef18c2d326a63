"""Detectors find the events of rendered motion at every frame rate, and reject unusable input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import angle_between_deg
from talkingeyes.core.motion import Blink, HeadMovement
from talkingeyes.evaluation.detectors.blinks import detect_blinks
from talkingeyes.evaluation.detectors.fixations import detect_fixations, detect_fixations_idt
from talkingeyes.evaluation.detectors.gaze_states import densest_direction, detect_gaze_states
from talkingeyes.evaluation.detectors.head_movements import detect_head_movements
from talkingeyes.evaluation.detectors.saccades import detect_saccades
from talkingeyes.evaluation.detectors.scoring import (
    DetectionCounts,
    cohen_kappa,
    count_matches,
    event_mask,
    match_events,
)
from talkingeyes.evaluation.detectors.signal import runs
from talkingeyes.physiology import blinks, eye_head, saccades

RATES = (25.0, 30.0, 60.0, 120.0, 250.0, 500.0, 1000.0)
SECONDS = 30.0


def chain(seed=0, min_deg=2.0, seconds=SECONDS):
    """Saccades of at least two degrees, about half a second apart."""
    rng = np.random.default_rng(seed)
    made, place, time_s = [], np.zeros(2), 0.3
    while time_s < seconds - 0.5:
        size = saccades.sample_amplitudes_rad(1, rng, min_deg=min_deg)[0]
        direction = saccades.sample_directions(1, rng)[0]
        step = size * direction / np.hypot(*direction)
        target = place + (step if np.hypot(*(place + step)) < 0.4 else -step)
        made.append(saccades.sample_saccade(time_s, place, target, rng))
        place, time_s = target, time_s + rng.uniform(0.25, 0.9)
    return made


def gaze_at(fps, made, noise_deg=0.0, seconds=SECONDS):
    path = saccades.gaze_path(made, (0.0, 0.0), np.arange(int(seconds * fps)) / fps)
    return path + np.radians(noise_deg) * np.random.default_rng(1).standard_normal(path.shape)


def amplitudes_deg(made):
    start, end = (np.array([getattr(each, name) for each in made]) for name in ("start_rad", "end_rad"))
    return angle_between_deg(rotation.angles_to_direction(start), rotation.angles_to_direction(end))


@pytest.mark.parametrize("fps", RATES)
def test_saccades_are_found_at_every_rate(fps):
    made = chain()
    found = detect_saccades(gaze_at(fps, made), fps)
    agreed = count_matches(found.onset_s, np.array([each.onset_s for each in made]), 0.05).score
    assert agreed.precision == 1.0 and agreed.recall == 1.0
    assert abs(agreed.onset_error_s) < 0.003 and agreed.onset_iqr_s < 0.4 / fps + 0.002
    assert np.abs(found.amplitude_deg - amplitudes_deg(made)).max() < 0.3
    known = np.array([np.subtract(each.end_rad, each.start_rad) for each in made])
    assert np.allclose(found.displacement_rad, known, atol=np.radians(0.3))
    assert np.allclose(found.start_rad, [each.start_rad for each in made], atol=np.radians(0.4))


@pytest.mark.parametrize("fps", [60.0, 120.0, 500.0])
def test_durations_are_measured_from_60_fps(fps):
    made = [each for each in chain(min_deg=4.0)]
    found = detect_saccades(gaze_at(fps, made), fps)
    error = found.duration_s - [each.duration_s for each in made]
    assert abs(np.median(error)) < 0.005 and np.percentile(np.abs(error), 90) < 0.01


def test_peak_speeds_follow_the_main_sequence_as_sampled():
    made = chain()
    native = np.degrees(saccades.peak_speed(np.radians(amplitudes_deg(made))))
    for fps, low, high in [(25.0, 0.35, 0.9), (120.0, 0.8, 1.1), (500.0, 0.8, 1.1)]:
        ratio = detect_saccades(gaze_at(fps, made), fps).peak_speed_deg_s / native
        assert low < np.median(ratio) < high


@pytest.mark.parametrize(("step", "direction"), [((1, 0), 0.0), ((0, 1), 90.0), ((-1, 0), 180.0), ((0, -1), -90.0)])
def test_directions_are_of_the_subject(step, direction):
    gaze = np.zeros((50, 2))
    gaze[20:] = np.radians(8.0) * np.array(step)
    found = detect_saccades(gaze, 25.0)
    assert np.degrees(found.direction_rad) == pytest.approx([direction])
    assert found.amplitude_deg == pytest.approx([8.0])
    assert found.onset_s[0] < 19.5 / 25 < found.offset_s[0]


def test_a_degree_of_yaw_is_less_when_looking_up():
    gaze = np.radians(np.array([[0.0, 60.0]] * 25 + [[8.0, 60.0]] * 25))
    assert detect_saccades(gaze, 25.0).amplitude_deg == pytest.approx([4.0], rel=0.01)


@pytest.mark.parametrize(("fps", "noise_deg"), [(25.0, 0.2), (25.0, 1.0), (60.0, 0.2), (120.0, 0.2), (500.0, 0.05)])
def test_noise_makes_few_saccades(fps, noise_deg):
    rng = np.random.default_rng(0)
    noise = np.radians(noise_deg) * rng.standard_normal((int(60 * fps), 2))
    assert len(detect_saccades(noise, fps)) <= 3
    made = chain(min_deg=9 * noise_deg + 2.0)
    found = detect_saccades(gaze_at(fps, made, noise_deg), fps)
    agreed = count_matches(found.onset_s, np.array([each.onset_s for each in made]), 0.05).score
    assert agreed.recall > 0.9 and agreed.precision > 0.95


def test_slow_movement_is_no_saccade():
    pursuit = np.stack([np.radians(20.0) * np.sin(np.arange(250) / 25), np.zeros(250)], axis=1)
    assert len(detect_saccades(pursuit, 25.0)) == 0
    assert len(detect_saccades(np.zeros((250, 2)), 25.0)) == 0


@pytest.mark.parametrize("fps", RATES)
def test_events_are_ordered_and_finite_for_any_motion(fps):
    rng = np.random.default_rng(0)
    time_s = np.arange(int(4 * fps)) / fps
    noise = rng.standard_normal((len(time_s), 2))
    circle = np.stack([np.sin(2 * np.pi * time_s * fps / 4), np.cos(2 * np.pi * time_s * fps / 4)], axis=1)
    for gaze in (0.2 * circle, 0.1 * noise, 0.02 * np.cumsum(noise, axis=0), 0.3 * np.sign(noise)):
        found = detect_saccades(gaze, fps)
        for values in (found.onset_s, found.offset_s, found.amplitude_deg, found.direction_rad, found.peak_speed_deg_s):
            assert np.isfinite(values).all()
        assert (np.diff(found.onset_s) > 0).all() and (found.duration_s > 0).all() and (found.amplitude_deg > 0).all()
        fixations = detect_fixations(gaze, fps, saccades=found)
        assert (np.diff(fixations.onset_s) > 0).all() and (fixations.duration_s >= 0.1 - 1e-9).all()
        assert np.isfinite(fixations.centre_rad).all()
        detect_head_movements(np.concatenate([gaze, gaze[:, :1]], axis=1), fps)
        detect_blinks(gaze, fps)
        assert len(detect_gaze_states(gaze, fps).averted) == len(gaze)


def test_an_oscillation_after_a_saccade_is_no_saccade():
    gaze = gaze_at(500.0, chain()[:1])
    start = int(500 * 0.3) + 25
    gaze[start : start + 20, 0] += np.radians(0.8) * np.sin(np.linspace(0, 2 * np.pi, 20))
    found = detect_saccades(gaze, 500.0)
    assert len(found) == 1 and found.amplitude_deg[0] == pytest.approx(amplitudes_deg(chain()[:1])[0], abs=0.1)
    assert len(detect_saccades(gaze[start - 5 :], 500.0)) > 0


def test_invalid_frames_are_ignored():
    made = chain()
    gaze, valid = gaze_at(25.0, made), np.ones(750, bool)
    valid[300:400] = False
    gaze[300:400] = np.nan
    found = detect_saccades(gaze, 25.0, valid)
    onset = np.array([each.onset_s for each in made])
    seen = (onset < 11.9) | (onset > 16.0)
    assert ((found.onset_s < 12.0) | (found.onset_s > 15.9)).all()
    assert count_matches(found.onset_s, onset[seen], 0.05).score.f1 > 0.98
    fixations = detect_fixations(gaze, 25.0, valid)
    assert not ((fixations.onset_s < 15.9) & (fixations.offset_s > 12.0)).any()
    assert not len(detect_saccades(gaze, 25.0, np.zeros(750, bool)))


@given(st.integers(0, 30), st.floats(-0.3, 0.3), st.floats(-0.1, 0.1))
def test_saccades_do_not_depend_on_where_straight_ahead_is(seed, yaw_rad, pitch_rad):
    gaze = gaze_at(25.0, chain(seed, seconds=5.0), seconds=5.0)
    here, there = detect_saccades(gaze, 25.0), detect_saccades(gaze + np.array([yaw_rad, 0.0]), 25.0)
    assert np.allclose(here.onset_s, there.onset_s) and np.allclose(here.amplitude_deg, there.amplitude_deg)
    mirrored = detect_saccades(gaze * [-1.0, 1.0], 25.0)
    assert np.allclose(mirrored.displacement_rad, here.displacement_rad * [-1.0, 1.0])
    assert np.allclose(np.cos(mirrored.direction_rad), -np.cos(here.direction_rad))
    assert len(detect_saccades(gaze + np.array([0.0, pitch_rad]), 25.0)) == pytest.approx(len(here), abs=1)


@pytest.mark.parametrize("fps", [25.0, 120.0, 500.0])
def test_fixations_lie_between_saccades(fps):
    made = chain()
    gaze = gaze_at(fps, made)
    found = detect_fixations(gaze, fps)
    start = np.array([0.0, *(each.onset_s + each.duration_s for each in made)])
    stop = np.array([*(each.onset_s for each in made), SECONDS - 1 / fps])
    assert len(found) == len(start)
    assert np.allclose(found.onset_s, start, atol=0.02) and np.allclose(found.offset_s, stop, atol=0.02)
    assert np.allclose(found.centre_rad[1:], [each.end_rad for each in made], atol=np.radians(0.3))
    assert np.array_equal(detect_fixations(gaze, fps, saccades=detect_saccades(gaze, fps)).onset_s, found.onset_s)
    other = detect_fixations_idt(gaze, fps)
    assert count_matches(other.onset_s, start, 0.06).score.f1 > 0.95
    assert (other.duration_s >= 0.1 - 1e-9).all()


def test_noise_does_not_split_a_fixation():
    assert len(detect_fixations(gaze_at(120.0, [], 0.3), 120.0)) == 1
    assert not len(detect_fixations_idt(gaze_at(25.0, [], 2.0), 25.0))


def drawn_blinks():
    return tuple(blinks.sample_blinks(blinks.PHYSIOLOGICAL, 120.0, np.random.default_rng(0), rate_per_min=25.0))


@pytest.mark.parametrize("fps", [25.0, 30.0, 60.0, 120.0, 500.0])
def test_blinks_are_found(fps):
    drawn = [each for each in drawn_blinks() if blinks.end_s(each) < 119.5 and each.onset_s > 0.1]
    times_s = np.arange(int(120 * fps)) / fps
    rest = 0.05 + 0.03 * np.sin(2 * np.pi * 0.3 * times_s)
    lid = rest + (1 - rest) * blinks.blink_closure(drawn, times_s)
    found = detect_blinks(np.stack([lid, lid], axis=1), fps)
    agreed = count_matches(found.onset_s, np.array([each.onset_s for each in drawn]), 0.06).score
    assert agreed.precision == 1.0 and agreed.recall == 1.0 and abs(agreed.onset_error_s) < 0.03
    assert np.median(np.abs(found.depth - [each.depth for each in drawn])) < 0.12
    assert ((found.onset_s < found.peak_s) & (found.peak_s < found.offset_s)).all()
    assert np.array_equal(detect_blinks(lid, fps).onset_s, found.onset_s)


def test_other_closures_are_no_blinks():
    times_s = np.arange(500) / 25
    squint = np.where(times_s > 10, 0.2, 0.0)
    asleep = np.where((times_s > 5) & (times_s < 8), 1.0, 0.0)
    wide = -0.2 * np.ones(500)
    assert not len(detect_blinks(squint, 25.0)) and not len(detect_blinks(asleep, 25.0))
    assert not len(detect_blinks(wide, 25.0)) and not len(detect_blinks(np.zeros((500, 2)), 25.0))
    lid = blinks.blink_closure([Blink(5.0, 0.08, 0.03, 0.2, 1.0)], times_s)
    assert len(detect_blinks(lid, 25.0)) == 1 and not len(detect_blinks(lid, 25.0, times_s < 4.9))


def test_two_blinks_in_a_row_are_two_and_a_flutter_is_one():
    times_s = np.arange(2000) / 100
    twice = blinks.blink_closure([Blink(5.0, 0.08, 0.03, 0.2, 1.0), Blink(5.35, 0.08, 0.03, 0.2, 1.0)], times_s)
    assert len(detect_blinks(twice, 100.0)) == 2
    flutter = np.where((times_s > 5.0) & (times_s < 5.2), 0.8 + 0.1 * np.sin(times_s * 120), 0.0)
    assert len(detect_blinks(flutter, 100.0)) == 1


@pytest.mark.parametrize("fps", [25.0, 60.0, 120.0, 500.0])
def test_head_movements_are_found(fps):
    rng = np.random.default_rng(0)
    made = []
    for onset in np.arange(0.5, 28.0, 1.5):
        delta = np.radians(rng.uniform(2.0, 12.0)) * rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)]
        duration = float(eye_head.head_duration_s(np.linalg.norm(delta)))
        made.append(HeadMovement(float(onset), duration, tuple(delta)))
    found = detect_head_movements(eye_head.head_path(made, np.arange(int(30 * fps)) / fps), fps)
    assert len(found) == len(made)
    middle = [each.onset_s + each.duration_s / 2 for each in made]
    assert np.allclose((found.onset_s + found.offset_s) / 2, middle, atol=0.03)
    off = np.linalg.norm(found.displacement_rad - [each.delta_rad for each in made], axis=1)
    assert (off < 0.12 * np.linalg.norm([each.delta_rad for each in made], axis=1)).all()
    peak = 1.875 * np.degrees([np.linalg.norm(each.delta_rad) / each.duration_s for each in made])
    assert np.allclose(found.peak_speed_deg_s, peak, rtol=0.12)
    assert np.allclose(found.amplitude_deg, np.degrees(np.linalg.norm(found.displacement_rad, axis=1)))


def test_a_nod_is_down_and_up():
    made = [HeadMovement(1.0, 0.35, (0.06, 0.0, 0.0)), HeadMovement(1.35, 0.4, (-0.06, 0.0, 0.0))]
    found = detect_head_movements(eye_head.head_path(made, np.arange(75) / 25), 25.0)
    assert len(found) == 2 and found.displacement_rad[0, 0] > 0.05 and found.displacement_rad[1, 0] < -0.05
    slow = np.radians(3.0) * np.sin(np.arange(250) / 25)[:, None] * [1.0, 1.0, 0.0]
    assert not len(detect_head_movements(slow, 25.0))


def test_gaze_states():
    rng = np.random.default_rng(0)
    partner, away = np.radians([2.0, -1.0]), np.radians([14.0, 5.0])
    states = np.repeat([False, True, False, True, False], [100, 50, 80, 60, 90])
    gaze = np.where(states[:, None], away, partner) + np.radians(0.8) * rng.standard_normal((380, 2))
    gaze[40:41] = away  # a glance of one frame
    found = detect_gaze_states(gaze, 25.0)
    assert np.array_equal(found.averted, states)
    assert np.degrees(np.hypot(*(found.partner_rad - partner))) < 0.3
    assert np.allclose(found.duration_s, [4.0, 2.0, 3.2, 2.4, 3.6])
    assert found.dwell_averted.tolist() == [False, True, False, True, False]
    told = detect_gaze_states(gaze, 25.0, partner_rad=away)
    assert np.array_equal(told.averted[45:], ~states[45:])
    assert not detect_gaze_states(gaze, 25.0, radius_deg=40.0).averted.any()


def test_gaze_states_without_frames():
    assert np.array_equal(densest_direction(np.zeros((0, 2)), 0.1), np.zeros(2))
    gaze = np.full((50, 2), np.nan)
    gaze[25:] = 0.0
    valid = np.isfinite(gaze[:, 0])
    assert detect_gaze_states(gaze, 25.0, valid=valid).averted.tolist() == [False] * 50


ALL = (
    lambda values, fps, valid: detect_saccades(values[:, :2], fps, valid),
    lambda values, fps, valid: detect_fixations(values[:, :2], fps, valid),
    lambda values, fps, valid: detect_fixations_idt(values[:, :2], fps, valid),
    lambda values, fps, valid: detect_blinks(values[:, :2], fps, valid),
    detect_head_movements,
    lambda values, fps, valid: detect_gaze_states(values[:, :2], fps, valid=valid),
)


@pytest.mark.parametrize("detect", ALL)
def test_bad_input_is_one_line_error(detect):
    values = np.zeros((100, 3))
    wrong = values.copy()
    wrong[7] = np.nan
    for arguments, says in [
        ((wrong, 25.0, None), "NaN or infinite values in 1 frames, first in frame 7"),
        ((values, 5.0, None), "fps should be between 10 and 2000, got 5"),
        ((values, float("nan"), None), "fps should be between 10 and 2000, got nan"),
        ((values, 120.0, None), r"should last 1 s or more \(120 frames at 120 fps\), got 100 frames"),
    ]:
        with pytest.raises(InputError, match=says) as error:
            detect(*arguments)
        assert "\n" not in str(error.value)
    detect(wrong, 25.0, np.arange(100) != 7)
    detect(values, 25.0, np.zeros(100, bool))


def test_runs_and_frames_during_events():
    flags = np.array([1, 1, 0, 1, 1, 1, 0], bool)
    found = runs(flags)
    assert found.first.tolist() == [0, 3] and found.last.tolist() == [1, 5]
    apart = np.array([0, 0, 0, 0, 1, 0, 0], bool)
    assert runs(flags, apart).first.tolist() == [0, 3, 4] and runs(flags, apart).last.tolist() == [1, 3, 5]
    assert event_mask(np.array([0.2, 0.8]), np.array([0.4, 5.0]), 10.0, 12).nonzero()[0].tolist() == [
        2,
        3,
        4,
        8,
        9,
        10,
        11,
    ]


@given(st.lists(st.floats(0, 10), max_size=12), st.lists(st.floats(0, 10), max_size=12), st.floats(0.01, 1.0))
def test_matching_is_one_to_one_and_maximal(found, known, tolerance_s):
    from scipy.optimize import linear_sum_assignment

    left, right = np.sort(np.array(found, float)), np.sort(np.array(known, float))
    pairs = match_events(left, right, tolerance_s)
    assert len(set(pairs.found)) == len(set(pairs.known)) == len(pairs.found)
    assert (np.abs(left[pairs.found] - right[pairs.known]) <= tolerance_s + 1e-9).all()
    near = np.abs(left[:, None] - right) <= tolerance_s
    rows, columns = linear_sum_assignment(-near.astype(int))
    assert len(pairs.found) == near[rows, columns].sum()


def test_scores():
    agreed = count_matches(np.array([1.0, 2.01, 3.0, 9.0]), np.array([1.02, 2.0, 5.0]), 0.05).score
    assert agreed.precision == 0.5 and agreed.recall == pytest.approx(2 / 3) and agreed.f1 == pytest.approx(4 / 7)
    assert agreed.onset_error_s == pytest.approx(-0.005) and agreed.found == 4 and agreed.known == 3
    both = count_matches(np.array([1.0]), np.array([1.1]), 0.2) + count_matches(
        np.array([2.0, 3.0]), np.array([2.1]), 0.2
    )
    assert both.score.precision == pytest.approx(2 / 3) and both.score.onset_error_s == pytest.approx(-0.1)
    assert np.isnan(
        [DetectionCounts().score.precision, DetectionCounts().score.recall, DetectionCounts().score.f1]
    ).all()
    one = np.array([True, True, False, False])
    assert cohen_kappa(one, one) == 1.0 and cohen_kappa(one, ~one) == -1.0
    assert cohen_kappa(one, np.array([True, False, True, False])) == 0.0
    assert np.isnan(cohen_kappa(np.ones(3, bool), np.ones(3, bool)))
