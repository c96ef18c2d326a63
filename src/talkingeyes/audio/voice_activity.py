"""Voice activity by level, for sounds without an annotation.

A 10 ms step counts as speech if its level is within 35 dB of the loud parts and 6 dB above the quiet ones. Gaps shorter
than 0.25 s do not end speech, and bursts shorter than 0.12 s do not start it. Music and noise count as speech. A silent
sound has none.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.prosody import energy_dbfs
from talkingeyes.audio.waveform import SAMPLE_RATE, SILENT_DBFS, loudest_dbfs

STEP_S, WINDOW_S, FLOOR_DBFS = 0.01, 0.04, -90.0
BELOW_LOUD_DB, ABOVE_QUIET_DB = 35.0, 6.0
MIN_GAP_S, MIN_SPEECH_S = 0.25, 0.12


def detect_speech(sound: Float[ndarray, " N"]) -> Annotation:
    """An annotation with speaking spans only, of a 16 kHz sound."""
    if not len(sound) or loudest_dbfs(sound) < SILENT_DBFS:
        return Annotation()
    times_s = np.arange(int(len(sound) / SAMPLE_RATE / STEP_S)) * STEP_S
    level = energy_dbfs(sound, times_s, WINDOW_S, FLOOR_DBFS)
    quiet, loud = np.percentile(level, [5, 95])
    loud_enough = level > max(loud - BELOW_LOUD_DB, min(quiet + ABOVE_QUIET_DB, loud - ABOVE_QUIET_DB))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], loud_enough, [0]])))
    spans: list[tuple[float, float]] = []
    for start, end in zip(edges[::2] * STEP_S, edges[1::2] * STEP_S, strict=True):
        if spans and start - spans[-1][1] < MIN_GAP_S:
            spans[-1] = (spans[-1][0], float(end))
        else:
            spans.append((float(start), float(end)))
    return Annotation(speaking=tuple(Span(start, end) for start, end in spans if end - start >= MIN_SPEECH_S))
