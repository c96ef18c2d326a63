"""Gaze that looks at nothing: a baseline that a measure must fail to be worth anything.

The eyes jump to a direction drawn uniformly every 0.2 to 5 s and rest there; the head is still, and sound is not used.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

HOLD_S = (0.2, 5.0)
HALF_RANGE_DEG = (20.0, 10.0)  # of yaw and pitch: what eyes do without the head


def uniform_gaze_deg(frames: int, fps: float, rng: np.random.Generator) -> Float[ndarray, "T 2"]:
    """Gaze in space of T frames."""
    gaze, start = np.empty((frames, 2)), 0
    while start < frames:
        stop = start + max(1, round(rng.uniform(*HOLD_S) * fps))
        gaze[start:stop] = rng.uniform(-1, 1, 2) * HALF_RANGE_DEG
        start = stop
    return gaze
