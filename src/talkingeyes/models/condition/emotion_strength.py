"""Emotion as numbers: the strength of each emotion but neutral."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.models.face.style import EMOTIONS, NEUTRAL, FaceStyle
from talkingeyes.physiology.face import INTENSITY_STRENGTH

STRENGTH_EMOTIONS = tuple(name for name in EMOTIONS if name != NEUTRAL)


def emotion_strengths(style: FaceStyle) -> Float[ndarray, " E"]:
    """Strength (0 to 1) of each of STRENGTH_EMOTIONS; zero if neutral."""
    found = np.zeros(len(STRENGTH_EMOTIONS), np.float32)
    if style.emotion != NEUTRAL:
        found[STRENGTH_EMOTIONS.index(style.emotion)] = INTENSITY_STRENGTH[style.intensity]
    return found
