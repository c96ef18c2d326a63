"""Where speech starts and ends, as channels of the speech embedding.

People avert gaze from more than a second before they start to speak, and return at the end (docs/conventions.md and
physiology name the sources), so what matters of speech lies outside a short window. The time since and until the
nearest onset and offset says it in four numbers. The future is known for whole sounds only: streams have none of these
channels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Span

BOUNDARY_CHANNELS = ("voice_activity", "since_onset", "since_offset", "until_onset", "until_offset")
FARTHEST_S = 5.0  # longer times, and times without such a boundary, are equal
RESOLUTION_S = 0.2  # times are compressed as log(1 + t / RESOLUTION_S)


def boundary_channels(speaking: Sequence[Span], times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 5"]:
    """Whether someone speaks, and the compressed times since and until the nearest onset and offset of speech.

    `speaking`: spans in order of time.
    """
    starts, ends = (np.array([getattr(span, side) for span in speaking]) for side in ("start_s", "end_s"))
    begun, ended = (np.searchsorted(marks, times_s, side="right") for marks in (starts, ends))
    since = [_elapsed(times_s, marks, known - 1) for marks, known in ((starts, begun), (ends, ended))]
    until = [-_elapsed(times_s, marks, known) for marks, known in ((starts, begun), (ends, ended))]
    distances = [np.log1p(np.minimum(np.abs(each), FARTHEST_S) / RESOLUTION_S) for each in (*since, *until)]
    return np.stack([(begun > ended).astype(float), *distances], axis=1)


def _elapsed(times_s: Float[ndarray, " T"], marks_s: Float[ndarray, " N"], index: ndarray) -> Float[ndarray, " T"]:
    """Time from the mark of each index, infinite where there is none."""
    bounded = np.concatenate([[-np.inf], marks_s, [np.inf]])
    return np.asarray(times_s - bounded[index + 1])
