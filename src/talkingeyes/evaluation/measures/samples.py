"""Motions under one sound: Diversity, energy score, the nearest sample (minADE), and correlation with the reference.

The first three need several motions of a sound and show whether samples differ as takes of people do, and whether the
true motion is among them. The truth is evaluated by comparing its takes with each other.

The correlations are of the direction of gaze aversion and of head posture. Individuals prefer a side when they avert
gaze, and a posture of the head. Over a population left and right are balanced, so distributions do not distinguish a
mirrored motion from the true one; these correlations do. A model that is not conditioned on the speaker has a
correlation of 0, which is no error; a negative value is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.distribution import windowed_energy_score
from talkingeyes.evaluation.measures.metric import HIGHER, LOWER, Extractor, Metric, Sums, Totals, ratio, safe_divide
from talkingeyes.evaluation.papers.talkingeyes_metrics import distance, diversity

# The energy score is computed on windows of this length.
WINDOW_S = 2.0
PARTS = {"gaze": "eye-in-head", "head": "head"}


def extract(motions: Sequence[Behaviour], part: str) -> Sums:
    """Diversity of the motions; energy score and smallest distance of those that are not the reference itself."""
    found: dict[str, Any] = {}
    if len(motions) > 1:
        stack = _stack(motions, part)
        found |= {f"{part}.sounds": 1.0, f"{part}.diversity": diversity(stack, _valid(motions, stack.shape[1]))}
    target = motions[0].required_reference
    others = [each for each in motions if not _same(each, target, part)]
    if len(others) > 1:
        stack = _stack([target, *others], part)
        true, samples = stack[0], stack[1:]
        scores = windowed_energy_score(samples, true, round(WINDOW_S * target.fps))
        apart = distance(samples, true, _valid([target], stack.shape[1]))
        found |= {
            f"{part}.judged_sounds": 1.0,
            f"{part}.windows": len(scores),
            f"{part}.energy": scores.sum(),
            f"{part}.nearest": apart.min(),
        }
    return found


def _stack(motions: Sequence[Behaviour], part: str) -> Float[ndarray, "S T C"]:
    frames = min(map(len, motions))
    return np.stack([getattr(each, part)[:frames].reshape(frames, -1) for each in motions])


def _valid(motions: Sequence[Behaviour], frames: int) -> Bool[ndarray, " T"]:
    """Frames that are valid in all motions; all frames, if there are none."""
    common = np.logical_and.reduce([each.valid[:frames] for each in motions])
    return common if common.any() else np.ones(frames, bool)


def _same(one: Behaviour, required_reference: Behaviour, part: str) -> bool:
    return np.array_equal(getattr(one, part), getattr(required_reference, part))


def _of_part(part: str) -> tuple[Metric, ...]:
    title = PARTS[part]
    extractor = Extractor(partial(extract, part=part), (part, "reference"), together=True)
    judged = partial(Metric, extractor=extractor, count_key=f"{part}.judged_sounds", min_count=5, direction=LOWER)
    return (
        Metric(
            f"samples/diversity_{part}",
            f"Diversity, {title}",
            "rad",
            "mean distance between pairs of motions of a sound, averaged over sounds",
            compute=ratio(f"{part}.diversity", f"{part}.sounds"),
            extractor=extractor,
            count_key=f"{part}.sounds",
            min_count=5,
            source="TalkingEyes, section V-B; ProbTalk3D",
            caveat="noise has the highest: compare with the value of the truth, which needs sounds with several takes",
        ),
        judged(
            f"samples/energy_score_{part}",
            f"energy score, {title}",
            "rad",
            f"E|X - y| - E|X - X'| / 2 of trajectories in windows of {WINDOW_S:g} s (fair version: Ferro 2014)",
            compute=ratio(f"{part}.energy", f"{part}.windows"),
            source="Gneiting & Raftery 2007",
            caveat=(
                "proper, but insensitive to spread in many dimensions; a good constant prediction scores almost as well"
            ),
        ),
        judged(
            f"samples/min_ade_{part}",
            f"nearest sample, {title}",
            "rad",
            "smallest mean distance of a sample to the true motion, averaged over sounds (minADE)",
            compute=ratio(f"{part}.nearest", f"{part}.judged_sounds"),
            source="coverage error (minADE)",
            caveat=("lower with more samples and with less movement: with S = 10 the mean pose is hard to beat"),
        ),
    )


METRICS = (*_of_part("gaze"), *_of_part("head"))


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

REFERENCE_CORRELATIONS = tuple(
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
