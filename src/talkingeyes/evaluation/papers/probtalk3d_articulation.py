"""Articulation metrics: lips close on bilabials and open on open vowels, and the jaw follows loudness.

bilabials_closed   fraction of p, b, m in which the lips meet: no further apart than at rest, within half a millimetre,
                   in at least one frame of the phoneme
bilabial_gap       the smallest gap in each of them, mm beyond the gap at rest (below 0: pressed)
vowel_gap          the largest gap in each open vowel; a mouth that is always shut gets 0
jaw_envelope       correlation of jaw opening and the sound's amplitude, at the best lag up to 0.1 s
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.prosody import energy_dbfs
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface

BILABIALS = ("p", "b", "m")
OPEN_VOWELS = ("a", "A", "0", "V", "&")
MAX_CLOSED_GAP_MM = 0.5
LAG_S = 0.1
WINDOW_S, FLOOR_DBFS = 0.04, -80.0  # of the amplitude envelope


@dataclass(frozen=True)
class ArticulationMetrics:
    """Metrics of one clip over all its samples; NaN if the clip has no such phonemes."""

    bilabials_closed: float
    bilabial_gap: float
    vowel_gap: float
    jaw_envelope: float


def articulation(
    surface: FaceSurface, samples: FaceSamples, annotation: Annotation, sound: Float[ndarray, " N"]
) -> ArticulationMetrics:
    """Articulation metrics from the face samples, the phonemes and the 16 kHz sound of a clip."""
    count, frames, _ = samples.jaw.shape
    envelope = 10 ** (energy_dbfs(sound, np.arange(frames) / samples.fps, WINDOW_S, FLOOR_DBFS) / 20)
    gaps = [surface.lip_gap_mm(samples, sample) for sample in range(count)]
    least = np.concatenate([extreme_gaps(gap, annotation, BILABIALS, samples.fps, np.min) for gap in gaps])
    most = np.concatenate([extreme_gaps(gap, annotation, OPEN_VOWELS, samples.fps, np.max) for gap in gaps])
    return ArticulationMetrics(
        bilabials_closed=_mean(least <= MAX_CLOSED_GAP_MM),
        bilabial_gap=_mean(least),
        vowel_gap=_mean(most),
        jaw_envelope=_mean(np.array([best_correlation(jaw[:, 0], envelope, samples.fps) for jaw in samples.jaw])),
    )


def extreme_gaps(
    gap_mm: Float[ndarray, " T"],
    annotation: Annotation,
    kinds: tuple[str, ...],
    fps: float,
    extreme: Callable[[ndarray], float],
) -> Float[ndarray, " P"]:
    """Smallest or largest gap within each phoneme of the given kinds; phonemes outside the clip are left out."""
    found = []
    for phoneme in annotation.phonemes:
        within = gap_mm[int(np.floor(phoneme.start_s * fps)) : int(np.ceil(phoneme.end_s * fps)) + 1]
        if phoneme.symbol.startswith(kinds) and len(within):
            found.append(float(extreme(within)))
    return np.array(found)


def best_correlation(jaw_rad: Float[ndarray, " T"], envelope: Float[ndarray, " T"], fps: float) -> float:
    """Highest correlation over lags of either sign; 0 if the jaw does not move."""
    reach = round(LAG_S * fps)
    return max(_correlation(jaw_rad, np.roll(envelope, lag)) for lag in range(-reach, reach + 1))


def _correlation(one: Float[ndarray, " T"], other: Float[ndarray, " T"]) -> float:
    one, other = one - one.mean(), other - other.mean()
    return float(one @ other / max(float(np.sqrt((one @ one) * (other @ other))), 1e-12))


def _mean(values: Sequence[float] | ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
