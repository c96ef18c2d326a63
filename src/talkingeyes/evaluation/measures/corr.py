"""Corr. metrics: audio-motion similarity by the contrastive critics, relative to other sounds of the same speaker.

Corr. is a cosine of learned features (evaluation/measures/critic.py), so its level has no meaning by itself. Motion
that is predictable from the voice but not realistic (a conditional mean) scores higher than people do. Corr. is
therefore compared with the value of the truth; its zero is the value of the same motion under other sounds of the same
speaker.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.metric import Extractor, Metric, Sums, ratio

# Parts of a motion and the names of their critics.
CRITICS = {"gaze": "eyes", "gaze_in_space": "gaze_in_space", "head": "head"}
TITLES = {"gaze": "eye-in-head", "gaze_in_space": "gaze in space", "head": "head"}
CAVEATS = {
    "gaze": "largely due to the head, against which the eyes counter-rotate",
    "gaze_in_space": "lowest of the three for people; a conditional mean scores higher than the truth",
    "head": "a conditional mean scores higher than the truth; the level depends on the critic",
}
MIN_SOUNDS = 20
# Number of other sounds of the speaker under which Corr. is computed.
SHUFFLED_SOUNDS = 2


@runtime_checkable
class CorrScorer(Protocol):
    """Interface that computes Corr. of motions under sounds (paper_metrics.corr.CriticCorrelation)."""

    def score_sounds(
        self, sounds: Sequence[Float[ndarray, "_ C"]], head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"]
    ) -> Float[ndarray, "N S"]: ...


@dataclass(frozen=True)
class CorrScores:
    """Corr. of S motions by one critic: under their own sound, and the mean under other sounds (NaN without any)."""

    matched: Float[ndarray, " S"]
    others: Float[ndarray, " S"]


def corr_scores(
    critics: Mapping[str, CorrScorer],
    speech: Float[ndarray, "T C"],
    others: Sequence[Float[ndarray, "_ C"]],
    head: Float[ndarray, "S T 3"],
    gaze: Float[ndarray, "S T 2 3"],
) -> dict[str, CorrScores]:
    """Corr. of the motions by each critic; another sound is compared over the shorter of both durations."""
    found = {}
    for name, critic in critics.items():
        own, *wrong = critic.score_sounds([speech, *others], head, gaze)
        found[name] = CorrScores(own, np.mean(wrong, axis=0) if wrong else np.full(len(head), np.nan))
    return found


def with_corr_scores(motions: Sequence[Behaviour], scores: Mapping[str, CorrScores]) -> list[Behaviour]:
    """Copy motions with their Corr.; score n belongs to motion n."""
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
    """Copy motions with their Corr., over the shorter of motion and sound; unchanged without head or gaze."""
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
    """Corr. of each part, and its difference to Corr. under other sounds."""
    corr = behaviour.corr
    assert corr is not None
    found: dict[str, Any] = {"corr.judged_motions": 1.0}
    shuffled = bool(np.isfinite(corr[:, 1]).all())
    found["corr.shuffled_motions"] = float(shuffled)
    for part, (own, others) in zip(CRITICS, corr, strict=True):
        found[f"corr.{part}"] = own
        found[f"corr.{part}_minus_shuffled"] = own - others if shuffled else 0.0
    return found


OBSERVER = Extractor(extract, ("head", "gaze", "corr"))


def _of_part(part: str) -> tuple[Metric, ...]:
    return (
        Metric(
            f"corr/{part}",
            f"Corr., {TITLES[part]}",
            "cosine",
            "cosine of the critic's features of sound and motion, averaged over windows of 8 s",
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
            "Corr. less Corr. of the same motion under other sounds of the speaker",
            compute=ratio(f"corr.{part}_minus_shuffled", "corr.shuffled_motions"),
            extractor=OBSERVER,
            count_key="corr.shuffled_motions",
            min_count=MIN_SOUNDS,
            source="mismatched audio: Nagy et al. 2025",
            caveat="a few hundredths even for the truth: needs many sounds",
        ),
    )


METRICS = tuple(metric for part in CRITICS for metric in _of_part(part))
