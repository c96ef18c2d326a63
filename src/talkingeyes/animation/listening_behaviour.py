"""Listening behaviour in a conversation, sampled from the times at which the two speakers have the turn.

The model receives the subject's speech alone; head and gaze during the subject's own silence are learnt (part of the
corpus is turn-taking conversation). The response to the partner is rule-based, with the distributions of the synthetic
data: in the partner's turns gaze is at the partner for a fraction of time sampled per person (mean 0.82; Argyle & Cook
1976: 0.75, Lee, Badler & Badler 2002: 0.95), and nods answer the partner's phrases. The starts of turns are
left to the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import HeadMovement
from talkingeyes.synthesis import head_gestures
from talkingeyes.synthesis.speakers import LOOK_LISTENING, sample_style

GAZE_FRACTION_LIMITS = (0.5, 0.98)


@dataclass(frozen=True)
class ListeningBehaviour:
    """The fraction of listening time with gaze at the partner, and nods."""

    gaze_fraction: float
    nods: tuple[HeadMovement, ...]


def sample_listening_behaviour(turns: Annotation, seeds: Sequence[int]) -> ListeningBehaviour:
    """Sample the listening behaviour of one person in a conversation with these turns."""
    rng = np.random.default_rng(seeds)
    style = sample_style(rng)
    gaze_fraction = float(np.clip(rng.beta(*LOOK_LISTENING), *GAZE_FRACTION_LIMITS))
    nods = tuple(head_gestures.listener_nods(turns, style, rng))
    return ListeningBehaviour(gaze_fraction, nods)
