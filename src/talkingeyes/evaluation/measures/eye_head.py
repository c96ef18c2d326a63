"""Coordination of both eyes, and of eyes and head; range and vergence of the eyes.

During fixations the eyes rotate against the head (vestibulo-ocular reflex): the slope of eye velocity on head velocity
is near -1. Its sign reveals a flipped axis, which norms do not. In a gaze shift the head follows later and covers a
part of the shift (Guitton & Volle 1987; Stahl 1999).

The reference ranges measure the head contribution to large gaze shifts from the motion. The onset of a head movement
cannot be detected to within 20 ms in a head that is never still, so onsets are taken from the events, where known.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.motion import Events
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.metric import (
    ZERO_TOLERANCE,
    Bins,
    Extractor,
    Metric,
    Sums,
    Totals,
    ratio,
    safe_divide,
)
from talkingeyes.evaluation.measures.pooled import Measurement, PooledArrays, measure_values, measurement

ANGLE_DEG = Bins(-45.0, 45.0, 180)
AXES = ("yaw", "pitch")
# Lags at which head velocity is compared with gaze velocity; at a positive lag the head is late.
LAGS_S = np.arange(-10, 21) * 0.04
# Time from saccade onset over which the head contribution is measured, and the smallest saccades that count.
HEAD_CONTRIBUTION_S, MIN_GAZE_SHIFT_DEG = 0.6, 8.0


def extract_binocular(behaviour: Behaviour) -> Sums:
    """Sums over valid frames of vergence, torsion, angles and yaw velocities of both eyes in the head."""
    assert behaviour.gaze is not None
    good, valid_steps = behaviour.valid, behaviour.valid_steps
    angles = np.degrees(behaviour.eye_rad[good])
    mean = angles.mean(axis=1)
    left, right = (np.diff(behaviour.eye_rad[:, eye, 0])[valid_steps] * behaviour.fps for eye in (0, 1))
    return {
        "pair.frames": good.sum(),
        "pair.vergence_deg": (angles[:, 1, 0] - angles[:, 0, 0]).sum(),
        "pair.torsion2": np.square(np.degrees(behaviour.gaze[good, :, 2])).mean(axis=1).sum(),
        "pair.yaw_2": np.square(mean[:, 0] - mean[:, 0].mean()).sum(),
        "pair.pitch_2": np.square(mean[:, 1] - mean[:, 1].mean()).sum(),
        "pair.pitch_3": ((mean[:, 1] - mean[:, 1].mean()) ** 3).sum(),
        "pair.left_2": left @ left,
        "pair.right_2": right @ right,
        "pair.left_right": left @ right,
        "pair.yaw": ANGLE_DEG(mean[:, 0]),
        "pair.pitch": ANGLE_DEG(mean[:, 1]),
    }


def extract_eye_head(behaviour: Behaviour) -> Sums:
    """Products of eye and head velocity between saccades, and head velocity around large saccades by lag."""
    fps, rest = behaviour.fps, behaviour.valid_steps & ~behaviour.in_saccade
    eye = np.diff(behaviour.eye_rad.mean(axis=1), axis=0) * fps
    head = np.diff(behaviour.head_rad, axis=0) * fps
    found: dict[str, Any] = {"counter.frames": rest.sum()}
    for axis, name in enumerate(AXES):
        of_eye, of_head = (
            each[rest, axis] - each[rest, axis].mean() if rest.any() else each[:0, axis] for each in (eye, head)
        )
        found |= {
            f"counter.{name}": of_eye @ of_head,
            f"counter.{name}_eye": of_eye @ of_eye,
            f"counter.{name}_head": of_head @ of_head,
        }
    return {**found, **_following(behaviour, head)}


def _following(behaviour: Behaviour, head_rad_s: Float[ndarray, "F 2"]) -> Sums:
    """Head rotation during large saccades, and head velocity along them by lag from their middle."""
    fps, shifts = behaviour.fps, behaviour.saccades
    large = shifts.amplitude_deg >= MIN_GAZE_SHIFT_DEG
    step = shifts.displacement_rad[large]
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    middle_s = (shifts.onset_s + shifts.offset_s)[large] / 2
    frame = np.round((middle_s[:, None] + LAGS_S) * fps - 0.5).astype(int)
    inside = (frame >= 0) & (frame < len(head_rad_s))
    along = np.einsum("nla,na->nl", head_rad_s[np.where(inside, frame, 0)], unit) * inside
    first = np.round(shifts.onset_s[large] * fps).astype(int)
    last = first + round(HEAD_CONTRIBUTION_S * fps)
    whole = last < len(behaviour)
    turn = behaviour.head_rad[last[whole]] - behaviour.head_rad[np.maximum(first[whole], 0)]
    return {
        "follow.gaze_shifts": large.sum(),
        "follow.turn": (turn * step[whole]).sum(),
        "follow.shift": np.square(step[whole]).sum(),
        "follow.velocity": along.sum(axis=0),
        "follow.counted": inside.sum(axis=0),
    }


BINOCULAR = Extractor(extract_binocular, ("gaze",))
EYE_HEAD = Extractor(extract_eye_head, ("head", "gaze"))


def _range(totals: Totals, axis: str) -> Float[ndarray, " D"]:
    return np.asarray(
        ANGLE_DEG.quantile(totals[f"pair.{axis}"], 0.95) - ANGLE_DEG.quantile(totals[f"pair.{axis}"], 0.05)
    )


def _root(totals: Totals, total: str) -> Float[ndarray, " D"]:
    return np.asarray(np.sqrt(safe_divide(totals[total], totals["pair.frames"])))


def _skewness(totals: Totals) -> Float[ndarray, " D"]:
    third = safe_divide(totals["pair.pitch_3"], totals["pair.frames"])
    return safe_divide(third, _root(totals, "pair.pitch_2") ** 3)


def _conjugacy(totals: Totals) -> Float[ndarray, " D"]:
    return safe_divide(totals["pair.left_right"], np.sqrt(totals["pair.left_2"] * totals["pair.right_2"]))


def _coupling(totals: Totals, axis: str) -> Float[ndarray, " D"]:
    scale = np.sqrt(totals[f"counter.{axis}_eye"] * totals[f"counter.{axis}_head"])
    return safe_divide(totals[f"counter.{axis}"], scale)


def _lag(totals: Totals) -> Float[ndarray, " D"]:
    """Lag of the highest mean head velocity along saccades, by a parabola through the three lags around the maximum.

    NaN where the head does not move.
    """
    mean = safe_divide(totals["follow.velocity"], totals["follow.counted"])
    known = np.nan_to_num(mean, nan=-np.inf)
    top = np.clip(known.argmax(axis=1), 1, len(LAGS_S) - 2)
    draw = np.arange(len(top))
    before, here, after = (mean[draw, top + shift] for shift in (-1, 0, 1))
    bend = before - 2 * here + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0)
    lag = LAGS_S[top] + np.clip(shift, -1, 1) * (LAGS_S[1] - LAGS_S[0])
    return np.where(np.abs(here) > ZERO_TOLERANCE, lag, np.nan)


_pair = partial(Metric, extractor=BINOCULAR, count_key="pair.frames", min_count=1500)
_counter = partial(Metric, extractor=EYE_HEAD, count_key="counter.frames", min_count=1500)
_follow = partial(Metric, extractor=EYE_HEAD, count_key="follow.gaze_shifts", min_count=100)

METRICS = (
    _pair(
        "eye/range_yaw",
        "range of eye-in-head yaw",
        "deg",
        "95th less 5th percentile of eye-in-head yaw, all frames pooled",
        compute=partial(_range, axis="yaw"),
        source="Stahl 1999; Guitton & Volle 1987",
        caveat="increased by a constant offset of each person (kappa)",
    ),
    _pair(
        "eye/range_pitch",
        "range of eye-in-head pitch",
        "deg",
        "95th less 5th percentile of eye-in-head pitch, all frames pooled",
        compute=partial(_range, axis="pitch"),
        source="Stahl 1999",
        caveat="as above",
    ),
    _pair(
        "eye/sd_yaw",
        "within-clip SD of eye-in-head yaw",
        "deg",
        "root mean square of eye-in-head yaw about the mean of the clip",
        compute=partial(_root, total="pair.yaw_2"),
        source="customary range: Stahl 1999",
        caveat="increases with the length of the clips",
    ),
    _pair(
        "eye/sd_pitch",
        "within-clip SD of eye-in-head pitch",
        "deg",
        "root mean square of eye-in-head pitch about the mean of the clip",
        compute=partial(_root, total="pair.pitch_2"),
        source="customary range: Stahl 1999",
        caveat="increases with the length of the clips",
    ),
    _pair(
        "eye/pitch_skew",
        "skewness of eye-in-head pitch",
        "",
        "third moment of eye-in-head pitch about the mean of the clip / SD^3",
        compute=_skewness,
        source="norms do not detect a sign error",
        caveat="determined by few long aversions",
    ),
    _pair(
        "eye/vergence",
        "vergence",
        "deg",
        "mean yaw of the right eye less yaw of the left eye; positive: the eyes converge",
        compute=ratio("pair.vergence_deg", "pair.frames"),
        source="Malinov et al. 2000; Elisei, Bailly & Casari 2007",
        caveat=(
            "pupils show the optical axis: a constant offset of up to 10 deg between the eyes is anatomical "
            "(kappa); 0 for parallel eyes"
        ),
    ),
    _pair(
        "eye/torsion",
        "torsion",
        "deg",
        "root mean square of the z component of the eyes' rotation vectors",
        compute=partial(_root, total="pair.torsion2"),
        source="Listing's law (Tweed & Vilis 1990)",
        caveat="rotations composed of yaw, then pitch (Fick angles) have false torsion: 3.5 deg at 20 by 20 deg",
        direction="lower",
    ),
    _pair(
        "eye/conjugacy",
        "conjugacy of the eyes",
        "correlation",
        "correlation of the yaw velocities of the two eyes",
        compute=_conjugacy,
        source="Collewijn, Erkelens & Steinman 1988",
        caveat="1 by construction where both eyes share one angle",
    ),
    _counter(
        "head_eye/slope_yaw",
        "head-eye slope, yaw",
        "deg/deg",
        "slope of eye-in-head on head yaw velocity between saccades; -1: gaze is still in space",
        compute=ratio("counter.yaw", "counter.yaw_head"),
        source="vestibulo-ocular reflex",
        caveat="noise in head pose brings it closer to 0; positive: an axis is flipped",
    ),
    _counter(
        "head_eye/slope_pitch",
        "head-eye slope, pitch",
        "deg/deg",
        "slope of eye-in-head on head pitch velocity between saccades",
        compute=ratio("counter.pitch", "counter.pitch_head"),
        source="vestibulo-ocular reflex",
        caveat="as above",
    ),
    _counter(
        "head_eye/correlation",
        "head-eye correlation, yaw",
        "correlation",
        "correlation of eye-in-head and head yaw velocity between saccades",
        compute=partial(_coupling, axis="yaw"),
        source="vestibulo-ocular reflex",
        caveat="noise in either brings it closer to 0",
    ),
    _follow(
        "head_eye/head_contribution",
        "head contribution to gaze shifts",
        "fraction",
        (
            "sum of head rotation x gaze shift / sum of gaze shift squared, over 0.6 s from the onset of "
            "saccades of at least 8 deg"
        ),
        compute=ratio("follow.turn", "follow.shift"),
        source="Stahl 1999; Freedman & Sparks 1997",
        caveat="negative where head or gaze is mirrored",
    ),
    _follow(
        "head_eye/head_lag",
        "lag of the head behind gaze",
        "s",
        "lag of the highest mean velocity of the head along saccades of at least 8 deg",
        compute=_lag,
        source="Guitton & Volle 1987; Zangemeister & Stark 1982",
        caveat="arbitrary where the head does not follow gaze",
    ),
)


# Statistics of the reference ranges, from arrays pooled over clips (pooled.py).
YAW_DEG, PITCH_DEG = 30.0, (-30.0, 20.0)
ROUNDING_DEG = 0.01  # of float32 files
FOLLOWED_S = (-0.1, 0.8)  # from saccade onset; the interval over which head rotation is measured
MIN_SHIFT_DEG = 5.0
LAG_S, ALIGNED, MIN_HEAD_MOVEMENT_DEG = (-0.12, 0.17), 0.8, 1.0


def extract_pool(behaviour: Behaviour, axis_divergence_rad: float) -> PooledArrays:
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
    whole = (first >= 0) & (last < len(behaviour)) & (found.amplitude_deg >= MIN_SHIFT_DEG)
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
        if np.hypot(*step) < np.radians(MIN_SHIFT_DEG):
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
