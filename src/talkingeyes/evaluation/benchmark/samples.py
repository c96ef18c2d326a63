"""Metrics over all motions of one sound: Diversity, energy score and distance to the nearest sample (minADE).

They need several motions of a sound and show whether samples differ as takes of people do, and whether the true motion
is among them. The truth is evaluated by comparing its takes with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.metric import LOWER, Extractor, Metric, Sums, ratio
from talkingeyes.evaluation.distribution.energy import windowed_energy_score
from talkingeyes.evaluation.paper_metrics.l2_diversity import distance, diversity

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
