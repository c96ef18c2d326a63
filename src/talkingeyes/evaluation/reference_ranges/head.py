"""The head in speech: speed, spectrum and correlation with prosody.

There are two different correlations with prosody. The first canonical correlation is fitted to each sentence (Busso et
al. 2005: about 0.7, optimistic by construction). The plain correlation over all frames is small.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.movement import FREQUENCY_HZ
from talkingeyes.evaluation.reference_ranges.clip_data import (
    FrameProsody,
    Measurement,
    PooledArrays,
    in_spans,
    measure_values,
    measurement,
    utterances,
)

SLOW_MOVEMENT_HZ = 1.8
MIN_SENTENCE_S = 1.5
RIDGE = 1e-6


def extract(behaviour: Behaviour, annotation: Annotation, frame_prosody: FrameProsody) -> PooledArrays:
    """Canonical correlations of the utterances, and products of head pitch and level in speech."""
    assert behaviour.head is not None
    frames = min(len(behaviour), len(frame_prosody.energy_dbfs))
    prosody = prosodic_features(frame_prosody)[:frames]
    found = []
    for span in utterances(annotation):
        low, high = round(span.start_s * behaviour.fps), min(round(span.end_s * behaviour.fps), frames)
        if high - low >= MIN_SENTENCE_S * behaviour.fps and behaviour.valid[low:high].all():
            found.append(canonical_correlation(behaviour.head[low:high], prosody[low:high]))
    speech = in_spans(annotation.speaking, behaviour)[:frames] & behaviour.valid[:frames]
    level, pitch = frame_prosody.energy_dbfs[:frames][speech], behaviour.head_rad[:frames, 1][speech]
    products = np.zeros(4)
    if len(level):
        level, pitch = level - level.mean(), np.degrees(pitch - pitch.mean())
        products = np.array([level @ pitch, level @ level, pitch @ pitch, len(level)])
    return {"cca.r": np.array(found), "tie.products": products[None]}


def prosodic_features(frame_prosody: FrameProsody) -> Float[ndarray, "T 6"]:
    """Level and log F0 (interpolated where unvoiced), with their first and second differences."""
    known = np.isfinite(frame_prosody.f0_hz)
    frames = np.arange(len(known))
    log_f0 = (
        np.interp(frames, frames[known], np.log(frame_prosody.f0_hz[known])) if known.any() else np.zeros(len(known))
    )
    base = np.stack([frame_prosody.energy_dbfs, log_f0], axis=1)
    first = np.gradient(base, axis=0)
    return np.concatenate([base, first, np.gradient(first, axis=0)], axis=1)


def canonical_correlation(one: Float[ndarray, "T A"], other: Float[ndarray, "T B"]) -> float:
    """First canonical correlation; NaN if either input is constant."""
    bases = []
    for each in (one, other):
        left, size, _ = np.linalg.svd(each - each.mean(axis=0), full_matrices=False)
        bases.append(left[:, size > RIDGE * max(float(size[0]), 1e-12)])
    if not (bases[0].shape[1] and bases[1].shape[1]):
        return float("nan")
    return float(min(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[0], 1.0))


def sentence_correlation(pool: PooledArrays) -> Measurement:
    """Mean over sentences of the first canonical correlation."""
    found = pool["cca.r"]
    found = found[np.isfinite(found)]
    return measure_values(found, np.mean, "sentences", 20)


def frame_correlation(pool: PooledArrays) -> Measurement:
    """Absolute correlation of head pitch and level over all speaking frames, both about the mean of the clip."""
    across, level, pitch, frames = pool["tie.products"].sum(axis=0)
    return measurement(abs(across) / max(np.sqrt(level * pitch), 1e-12), int(frames), "frames", 1500)


def fast_power_fraction(pool: PooledArrays) -> Measurement:
    """Percentage of the power of head velocity above 1.8 Hz."""
    if "head.power" not in pool:
        return measurement(np.nan, 0, "segments", 1)
    velocity = pool["head.power"].sum(axis=0) * np.square(FREQUENCY_HZ)
    total, segments = float(velocity.sum()), int(pool["head.segments"].sum())
    share = 100 * float(velocity[FREQUENCY_HZ > SLOW_MOVEMENT_HZ].sum()) / max(total, 1e-12)
    return measurement(share, segments, "segments", 40)


def speaking_speed(pool: PooledArrays) -> Measurement:
    """Mean head speed in speech, degrees per second."""
    frames = float(pool["speech.frames"].sum()) if "speech.frames" in pool else 0.0
    return measurement(
        float(pool["speech.speed_deg_s"].sum()) / frames if frames else np.nan, int(frames), "frames", 1500
    )
