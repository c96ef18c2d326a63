"""Lids of a person in the parameter of the Eyelid model: gains, saturation, fluctuation, blinks, rendered lids."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.head.eyelid.anatomy import EyelidParameters, upper_lid_rotation_rad
from talkingeyes.head.eyelid.model import gaze_predictors
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS
from talkingeyes.head.landmarks import EYE_CENTRES, landmarks
from talkingeyes.physiology import lids
from talkingeyes.physiology.lids import add_blinks, lid_closure_by_gaze, sample_eyelids
from talkingeyes.synthesis.take import _lid_drift

USUAL = EyelidParameters()
MEAN_EYELIDS = (USUAL, USUAL)
STILL = np.zeros((1, 2))


def looking(pitch_deg, yaw_deg=0.0):
    """Angles of both eyes for pitches."""
    pitch = np.radians(np.atleast_1d(np.asarray(pitch_deg, float)))
    return np.stack([np.full((len(pitch), 2), np.radians(yaw_deg)), np.repeat(pitch[:, None], 2, axis=1)], axis=-1)


def upper_deg(angles, lid):
    """Heights of the upper lids of the head, as angles about the eye centres."""
    points = landmarks(angles_to_gaze(angles), lid, np.zeros((len(lid), 3)))[:, EYE_LANDMARKS[:, 1:3]].mean(axis=2)
    arm_m = np.hypot(*(points[0] - EYE_CENTRES)[0, 1:])
    return np.degrees(np.arcsin((points[..., 1] - EYE_CENTRES[:, 1]) / arm_m))


def followed(angles, eyes=MEAN_EYELIDS, unrest=STILL):
    return lid_closure_by_gaze(angles, angles[..., 1], np.broadcast_to(unrest, angles.shape[:2]), eyes)


def test_the_lid_of_the_head_stands_where_the_persons_does():
    angles = looking([0, -20, -10, 10, 18])
    lid = followed(angles)
    turned = upper_deg(angles, lid) - upper_deg(angles, lid)[0]
    expected = np.degrees(upper_lid_rotation_rad(angles[..., 1], USUAL))
    assert turned == pytest.approx(expected, abs=0.8)
    assert np.abs(lid[0]).max() < 1e-9 and np.abs(lid).max() < 0.15


def test_gains_are_those_of_becker_and_fuchs():
    down, up = np.radians([-2.0, -20.0]), np.radians([2.0, 14.0])
    habits = [sample_eyelids(np.random.default_rng(seed))[0] for seed in range(200)]
    gains_down = [np.diff(upper_lid_rotation_rad(down, habit))[0] / np.diff(down)[0] for habit in habits]
    gains_up = [np.diff(upper_lid_rotation_rad(up, habit))[0] / np.diff(up)[0] for habit in habits]
    assert 0.92 < np.mean(gains_down) < 1.02 and 0.68 < np.mean(gains_up) < 0.9
    assert all(0.85 < gain < 1.1 for gain in gains_down) and all(0.55 < gain < 0.95 for gain in gains_up)
    late = upper_lid_rotation_rad(np.radians([15.0, 20.0]), USUAL)
    assert np.diff(late)[0] < 0.75 * np.diff(upper_lid_rotation_rad(np.radians([0.0, 5.0]), USUAL))[0]


def test_the_form_of_the_model_explains_most_but_not_all():
    rng = np.random.default_rng(0)
    angles = np.repeat(np.clip(rng.normal(0, np.radians([5.5, 4.0]), (1500, 1, 2)), -0.5, 0.35), 2, axis=1)
    times = np.linspace(0, 300, 1500)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        lid = followed(angles, sample_eyelids(rng), _lid_drift(rng).at(times))
        height = upper_deg(angles, lid)[:, 0]
        inputs = np.column_stack([gaze_predictors(angles[:, 0]), np.ones(len(height))])
        left = height - inputs @ np.linalg.lstsq(inputs, height, rcond=None)[0]
        assert 0.85 < 1 - left.var() / height.var() < 0.97


def test_lids_move_on_still_eyes_slowly_and_together():
    times = np.arange(0, 120, 0.04)
    unrest = np.concatenate([_lid_drift(np.random.default_rng(seed)).at(times) for seed in range(10)])
    assert np.degrees(unrest.std()) == pytest.approx(1.2, abs=0.15)
    assert np.degrees(np.abs(unrest).max()) < 6.0
    assert np.corrcoef(unrest.T)[0, 1] > 0.8
    lag = round(0.5 / 0.04)
    assert 0.15 < np.mean(unrest[:-lag] * unrest[lag:]) / np.mean(unrest**2) < 0.7


@given(st.floats(-30, 20), st.floats(-30, 30), st.integers(0, 50))
def test_a_full_blink_shuts_every_lid(pitch_deg, yaw_deg, seed):
    lid = followed(looking(pitch_deg, yaw_deg), sample_eyelids(np.random.default_rng(seed)))
    np.testing.assert_allclose(add_blinks(lid, np.ones_like(lid)), 1.0)
    np.testing.assert_array_equal(add_blinks(lid, np.zeros_like(lid)), lid)
    assert lid.min() >= lids.MIN_CLOSURE and lid.max() <= lids.MAX_CLOSURE


def test_a_drooping_lid_is_further_closed():
    ahead = looking(0)
    low = followed(ahead, (EyelidParameters(droop_rad=float(np.radians(2.0))), EyelidParameters()))
    assert low[0, 0] > 0.03 and abs(low[0, 1]) < 1e-9


def test_lids_come_a_little_late():
    angles = looking([-10.0])
    late = lid_closure_by_gaze(angles, angles[..., 1] + np.radians(5.0), STILL, MEAN_EYELIDS)
    assert late[0, 0] < followed(angles)[0, 0] - 0.05
