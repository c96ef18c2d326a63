"""Corr. metrics: audio-motion similarity by the critics, against other sounds of the same speaker.

Corr. is a cosine of learned features (evaluation/paper_metrics/corr.py), so its level means nothing by itself, and what
is predictable from the voice without being true (a conditional mean) scores higher than people do. It is therefore read
as a distance to the truth's own value, and its zero is the same motion under other sounds of the same speaker.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.metric import Extractor, Metric, Sums, ratio

# Parts of a motion and the critics that judge them.
CRITICS = {"gaze": "eyes", "gaze_in_space": "gaze_in_space", "head": "head"}
TITLES = {"gaze": "eye-in-head", "gaze_in_space": "gaze in space", "head": "head"}
CAVEATS = {
    "gaze": "driven by the head: the eyes counter-rotate under it",
    "gaze_in_space": "weakest of the three in life; a conditional mean beats the truth",
    "head": "a conditional mean beats the truth; the level depends on the critic",
}
MIN_SOUNDS = 20
# Other sounds of the speaker under which Corr. is taken.
SHUFFLED_SOUNDS = 2


@runtime_checkable
class CorrScorer(Protocol):
    """What gives Corr. of motions under sounds (metrics.correlation.Correlation)."""

    def score_sounds(
        self, sounds: Sequence[Float[ndarray, "_ C"]], head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"]
    ) -> Float[ndarray, "N S"]: ...


@dataclass(frozen=True)
class CorrScores:
    """Corr. of S motions by one critic: under their own sound, and the mean under others (NaN if there are none)."""

    matched: Float[ndarray, " S"]
    others: Float[ndarray, " S"]


def corr_scores(
    critics: Mapping[str, CorrScorer],
    speech: Float[ndarray, "T C"],
    others: Sequence[Float[ndarray, "_ C"]],
    head: Float[ndarray, "S T 3"],
    gaze: Float[ndarray, "S T 2 3"],
) -> dict[str, CorrScores]:
    """What each critic says of the motions; under another sound as far as both last."""
    found = {}
    for name, critic in critics.items():
        own, *wrong = critic.score_sounds([speech, *others], head, gaze)
        found[name] = CorrScores(own, np.mean(wrong, axis=0) if wrong else np.full(len(head), np.nan))
    return found


def with_corr_scores(motions: Sequence[Behaviour], scores: Mapping[str, CorrScores]) -> list[Behaviour]:
    """Motions with what the critics say of them: the n-th of `scores` is of the n-th motion."""
    parts = [scores[critic] for critic in CRITICS.values()]
    return [
        replace(motion, corr=np.array([[part.matched[index], part.others[index]] for part in parts]))
        for index, motion in enumerate(motions)
    ]


def with_corr(
    motions: Sequence[Behaviour],
    critics: Mapping[str, CorrScorer],
    speech: Float[ndarray, "T C"],
    others: Sequence[Float[ndarray, "_ C"]],
) -> list[Behaviour]:
    """Motions with head and gaze, each judged under the sound as far as both last; the others as they are."""
    judged = list(motions)
    alike: dict[int, list[int]] = defaultdict(list)
    for index, motion in enumerate(motions):
        if motion.head is not None and motion.gaze is not None:
            alike[min(len(motion), len(speech))].append(index)
    for frames, indices in alike.items():
        of_length = [motions[index] for index in indices]
        head, gaze = (np.stack([getattr(each, part)[:frames] for each in of_length]) for part in ("head", "gaze"))
        scores = corr_scores(critics, speech[:frames], others, head, gaze)
        for index, motion in zip(indices, with_corr_scores(of_length, scores), strict=True):
            judged[index] = motion
    return judged


def extract(behaviour: Behaviour) -> Sums:
    """Corr. of each part, and what it is more than under other sounds."""
    corr = behaviour.corr
    assert corr is not None
    found: dict[str, Any] = {"corr.judged_motions": 1.0}
    shuffled = bool(np.isfinite(corr[:, 1]).all())
    found["corr.shuffled_motions"] = float(shuffled)
    for part, (own, others) in zip(CRITICS, corr, strict=True):
        found[f"corr.{part}"] = own
        found[f"corr.{part}_minus_shuffled"] = own - others if shuffled else 0.0
    return found


OBSERVER = Extractor(
    extract,
    ("head", "gaze", "corr"),
    dict.fromkeys(
        (
            "corr.judged_motions",
            "corr.shuffled_motions",
            *(f"corr.{part}{end}" for part in CRITICS for end in ("", "_minus_shuffled")),
        ),
        1,
    ),
)


def _of_part(part: str) -> tuple[Metric, ...]:
    return (
        Metric(
            f"corr/{part}",
            f"Corr., {TITLES[part]}",
            "cosine",
            "mean over windows of 8 s of the cosine of the critic's features of sound and motion",
            compute=ratio(f"corr.{part}", "corr.judged_motions"),
            extractor=OBSERVER,
            count_key="corr.judged_motions",
            min_count=MIN_SOUNDS,
            source="TalkingEyes, section V-B.3; van den Oord et al. 2018",
            caveat=CAVEATS[part],
        ),
        Metric(
            f"corr/{part}_minus_shuffled",
            f"Corr. less Corr. under other sounds, {TITLES[part]}",
            "cosine",
            "the same less the same of that motion under other sounds of its speaker",
            compute=ratio(f"corr.{part}_minus_shuffled", "corr.shuffled_motions"),
            extractor=OBSERVER,
            count_key="corr.shuffled_motions",
            min_count=MIN_SOUNDS,
            source="FACTS 9 (same-speaker negatives)",
            caveat="a few hundredths even in truth: needs many sounds",
        ),
    )


METRICS = tuple(metric for part in CRITICS for metric in _of_part(part))
