"""Correlation with the reference under the same sound: direction of gaze aversion and head posture.

Individuals prefer a side when they avert gaze, and a posture of the head. Over a population left and right are
balanced, so distributions do not distinguish a mirrored motion from the true one; these correlations do. A model that
is not conditioned on the speaker has a correlation of 0, which is no error; a negative value is one.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.metric import HIGHER, Extractor, Metric, Sums, Totals, safe_divide

AVERSION = ("aversion_yaw", "aversion_pitch")
POSTURE = ("head_pitch", "head_yaw", "head_roll")  # components of the head's rotation vector
# Clips with less averted time are left out.
MIN_AVERTED_S = 0.4
MOMENTS = ("pairs", "x", "y", "xx", "yy", "xy")


def extract_aversion_direction(behaviour: Behaviour) -> Sums:
    """Mean direction of averted gaze relative to the partner, in motion and reference."""
    return _moments(AVERSION, _aversion(behaviour), _aversion(behaviour.required_reference))


def extract_head_posture(behaviour: Behaviour) -> Sums:
    """Mean rotation vector of the head, in motion and reference."""
    return _moments(POSTURE, _posture(behaviour), _posture(behaviour.required_reference))


def _aversion(behaviour: Behaviour) -> Float[ndarray, " 2"]:
    away = behaviour.states.averted & behaviour.valid
    if away.sum() < MIN_AVERTED_S * behaviour.fps:
        return np.full(2, np.nan)
    return np.asarray(np.degrees(behaviour.gaze_in_space_rad[away].mean(axis=0) - behaviour.states.partner_rad))


def _posture(behaviour: Behaviour) -> Float[ndarray, " 3"]:
    assert behaviour.head is not None
    return np.asarray(np.degrees(behaviour.head[behaviour.valid].mean(axis=0)))


def _moments(names: tuple[str, ...], ours: Float[ndarray, " C"], theirs: Float[ndarray, " C"]) -> Sums:
    found: dict[str, Any] = {}
    for name, x, y in zip(names, ours, theirs, strict=True):
        values = (1.0, x, y, x * x, y * y, x * y) if np.isfinite(x + y) else (0.0,) * len(MOMENTS)
        found |= {f"{name}.{moment}": value for moment, value in zip(MOMENTS, values, strict=True)}
    return found


def _correlation(totals: Totals, name: str) -> Float[ndarray, " D"]:
    count, x, y, xx, yy, xy = (totals[f"{name}.{moment}"] for moment in MOMENTS)
    scale = np.sqrt(np.maximum(count * xx - x**2, 0) * np.maximum(count * yy - y**2, 0))
    return safe_divide(count * xy - x * y, scale)


AVERSION_EXTRACTOR = Extractor(extract_aversion_direction, ("head", "gaze", "reference"))
POSTURE_EXTRACTOR = Extractor(extract_head_posture, ("head", "reference"))

_TITLES = {
    "aversion_yaw": ("yaw of aversion", AVERSION_EXTRACTOR, "mean yaw of averted gaze relative to the partner"),
    "aversion_pitch": ("pitch of aversion", AVERSION_EXTRACTOR, "mean pitch of averted gaze relative to the partner"),
    "head_pitch": ("mean head pitch", POSTURE_EXTRACTOR, "mean x component of the head's rotation vector"),
    "head_yaw": ("mean head yaw", POSTURE_EXTRACTOR, "mean y component of the head's rotation vector"),
    "head_roll": ("mean head roll", POSTURE_EXTRACTOR, "mean z component of the head's rotation vector"),
}

METRICS = tuple(
    Metric(
        f"reference_correlation/{name}",
        title,
        "correlation",
        f"correlation over clips between the {what} and that of the reference under the same sound",
        compute=partial(_correlation, name=name),
        extractor=extractor,
        count_key=f"{name}.pairs",
        min_count=30,
        direction=HIGHER,
        source="individual gaze sides and head postures: Rogers et al. 2018",
        caveat="0 is expected of a model that is not conditioned on the speaker; negative: an axis is flipped",
    )
    for name, (title, extractor, what) in _TITLES.items()
)
