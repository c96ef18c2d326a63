"""Loudness of each phoneme relative to the median stressed vowel, which drives the jaw (JALI, Edwards et al. 2016)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.waveform import SAMPLE_RATE

MIN_SAMPLES = 80
MAX_LOUDNESS = 4.0


def with_loudness(annotation: Annotation, sound: Float[ndarray, " N"]) -> Annotation:
    """Set the `loudness` of each phoneme to its RMS over the median RMS of stressed vowels, rounded to 0.001."""
    if not annotation.phonemes:
        return annotation
    power = np.concatenate([[0.0], np.cumsum(np.square(sound, dtype=np.float64))])
    spans_s = np.array([(phoneme.start_s, phoneme.end_s) for phoneme in annotation.phonemes])
    start, stop = np.clip(np.round(spans_s * SAMPLE_RATE).astype(int), 0, len(sound)).T
    stop = np.minimum(np.maximum(stop, start + MIN_SAMPLES), len(sound))
    rms = np.sqrt((power[stop] - power[start]) / np.maximum(stop - start, 1))
    stressed = np.array([phoneme.stressed for phoneme in annotation.phonemes])
    usual = np.median(rms[stressed] if stressed.any() else rms)
    loudness = np.round(np.minimum(rms / max(float(usual), 1e-6), MAX_LOUDNESS), 3)
    phonemes = [replace(each, loudness=float(value)) for each, value in zip(annotation.phonemes, loudness, strict=True)]
    return replace(annotation, phonemes=tuple(phonemes))
