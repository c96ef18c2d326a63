"""Range and vergence of the eyes, and head contribution and head lag of gaze shifts.

Stahl 1999: the head contributes beyond a threshold of eccentricity. Guitton & Volle 1987: it starts after the eye. The
onset of a head movement cannot be detected to within 20 ms in a head that is never still, so onsets are taken from the
events, where known. The head contribution is measured from the motion.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from talkingeyes.core.motion import Events
from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.reference_ranges.clip_data import Measurement, PooledArrays, measure_values, measurement

YAW_DEG, PITCH_DEG = 30.0, (-30.0, 20.0)
ROUNDING_DEG = 0.01  # of float32 files
FOLLOWED_S = (-0.1, 0.8)  # from saccade onset; the interval over which head rotation is measured
MIN_GAZE_SHIFT_DEG = 5.0
LAG_S, ALIGNED, MIN_HEAD_MOVEMENT_DEG = (-0.12, 0.17), 0.8, 1.0


def extract(behaviour: Behaviour, axis_divergence_rad: float) -> PooledArrays:
    """Frames within the range, vergence at the partner, and target eccentricity and head rotation of gaze shifts."""
    angles = np.degrees(behaviour.eye_rad[behaviour.valid])
    yaw, pitch = np.abs(angles[..., 0]).max(axis=1), angles[..., 1]
    inside = (yaw < YAW_DEG + ROUNDING_DEG) & (pitch > PITCH_DEG[0] - ROUNDING_DEG).all(axis=1)
    inside &= (pitch < PITCH_DEG[1] + ROUNDING_DEG).all(axis=1)
    at_partner = (behaviour.valid & ~behaviour.states.averted)[behaviour.valid]
    converged = angles[:, 1, 0] - angles[:, 0, 0] + np.degrees(axis_divergence_rad)
    return {
        "range.inside": np.array([[inside.sum(), len(inside)]]),
        "vergence.deg": np.array([[converged[at_partner].sum(), at_partner.sum()]]),
        **extract_gaze_shifts(behaviour),
    }


def extract_gaze_shifts(behaviour: Behaviour) -> dict[str, ndarray]:
    """Eccentricity of the target relative to the head, and rotation of the head towards it, for each large saccade."""
    fps, found = behaviour.fps, behaviour.saccades
    first = np.round((found.onset_s + FOLLOWED_S[0]) * fps).astype(int)
    last = np.round((found.onset_s + FOLLOWED_S[1]) * fps).astype(int)
    whole = (first >= 0) & (last < len(behaviour)) & (found.amplitude_deg >= MIN_GAZE_SHIFT_DEG)
    first, last = first[whole], last[whole]
    goal = found.start_rad[whole] + found.displacement_rad[whole]
    away = goal - behaviour.head_rad[first]
    eccentricity = np.linalg.norm(away, axis=1)
    turn = ((behaviour.head_rad[last] - behaviour.head_rad[first]) * away).sum(axis=1) / np.maximum(eccentricity, 1e-9)
    return {"shift.eccentricity_deg": np.degrees(eccentricity), "shift.head_deg": np.degrees(turn)}


def extract_events(events: Events) -> PooledArrays:
    """Head onset less eye onset, of head movements in the direction of a large saccade and near it in time."""
    lags = []
    for saccade in events.saccades:
        step = np.subtract(saccade.end_rad, saccade.start_rad)
        if np.hypot(*step) < np.radians(MIN_GAZE_SHIFT_DEG):
            continue
        for move in events.head_movements:
            turn = np.array([move.delta_rad[1], -move.delta_rad[0]])
            size, lag = float(np.hypot(*turn)), move.onset_s - saccade.onset_s
            aligned = turn @ step > ALIGNED * size * np.hypot(*step)
            if LAG_S[0] <= lag <= LAG_S[1] and aligned and size >= np.radians(MIN_HEAD_MOVEMENT_DEG):
                lags.append(lag)
                break
    return {"lag.s": np.array(lags)}


def within_motor_range(pool: PooledArrays) -> Measurement:
    """Percentage of frames with both eyes within the range of conversation."""
    inside, frames = pool["range.inside"].sum(axis=0)
    return measurement(100 * inside / max(frames, 1), int(frames), "frames", 100)


def vergence_deg(pool: PooledArrays) -> Measurement:
    """Mean angle between the lines of sight while looking at the partner, degrees."""
    total, frames = pool["vergence.deg"].sum(axis=0)
    return measurement(total / max(frames, 1), int(frames), "frames", 100)


def onset_lag_ms(pool: PooledArrays) -> Measurement:
    """Median of head onset less eye onset, milliseconds."""
    return measure_values(pool["lag.s"], lambda lags: 1000 * np.median(lags), "shifts with the head", 50)


def head_contribution(pool: PooledArrays, low_deg: float, high_deg: float) -> Measurement:
    """Head rotation as a fraction of target eccentricity, over gaze shifts in a range of eccentricities.

    A ratio of sums, so that unrelated head movements cancel.
    """
    eccentricity = pool["shift.eccentricity_deg"]
    within = (eccentricity >= low_deg) & (eccentricity < high_deg)
    total = float(eccentricity[within].sum())
    return measurement(float(pool["shift.head_deg"][within].sum()) / max(total, 1e-9), int(within.sum()), "shifts", 30)
