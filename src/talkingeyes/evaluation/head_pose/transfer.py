"""Style of a new person from a few seconds of motion: the nearest learnt style, or a blend of learnt styles.

The speaker classifier (Table 3) rates the similarity to each training speaker. Its confidences are the weights of the
blend, and the largest one selects the nearest style.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.head_pose.classifier import PoseClassifier

MIN_FRAMES = 32  # about a second; below, strided convolutions cover only padded borders


def blend_styles(classifier: PoseClassifier, pose: Float[ndarray, "T 6"]) -> Float[ndarray, " K"]:
    """Weights of the learnt styles for a few seconds of poses. Raises InputError below `MIN_FRAMES`."""
    if len(pose) < MIN_FRAMES:
        raise InputError(f"style: should have at least {MIN_FRAMES} frames of motion, got {len(pose)}")
    return np.asarray(classifier.probabilities((pose - pose.mean(0))[None])[0])


def nearest_style(shares: Float[ndarray, " K"]) -> Float[ndarray, " K"]:
    """One-hot weights of the style with the largest weight."""
    return np.asarray(np.eye(len(shares))[shares.argmax()])
