"""The style of somebody new from a few seconds of motion: the nearest learnt style, or a blend of them.

The classifier of speakers (Table 3) says how much the motion is like each training speaker's; its confidences are the
shares of a blend, and the largest names the nearest.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.head_pose.classifier import PoseClassifier

MIN_FRAMES = 32  # about a second: below, strided convolutions see nothing but their borders


def blend_styles(classifier: PoseClassifier, pose: Float[ndarray, "T 6"]) -> Float[ndarray, " K"]:
    """Shares of the learnt styles in a few seconds of centred poses."""
    if len(pose) < MIN_FRAMES:
        raise InputError(f"style: should be taken from at least {MIN_FRAMES} frames of motion, got {len(pose)}")
    return np.asarray(classifier.probabilities((pose - pose.mean(0))[None])[0])


def nearest_style(shares: Float[ndarray, " K"]) -> Float[ndarray, " K"]:
    """All of the style that has the largest share."""
    return np.asarray(np.eye(len(shares))[shares.argmax()])
