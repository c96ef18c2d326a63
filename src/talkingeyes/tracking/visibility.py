"""Visibility of eyes: lids open, and the head not turned so far that an eye is occluded.

The paper (III-A1) excludes clips with a "significant disparity in the distances from the left and right eye corners to
the two sides of the face". Here the disparity is |l - r| / (l + r), where l and r are the distances from the outer
corner of each eye to the outline beside it: 0 from the front, 1 if the outline covers the corner (24 degrees), more
beyond.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS, LANDMARK_NAMES

_CORNERS = [LANDMARK_NAMES.index(f"{side}_eye_outer") for side in ("left", "right")]
_OUTLINE = [LANDMARK_NAMES.index(f"{side}_outline_ear") for side in ("left", "right")]


class EyeVisibilitySettings(Settings):
    """An eye is hidden below a fraction of its open height (`open_percentile` of the clip), or beyond a disparity."""

    min_aperture: Annotated[float, Field(ge=0, lt=1)]
    open_percentile: Annotated[float, Field(ge=50, le=100)]
    disparity: Annotated[float, Field(gt=0, le=10)]


def eye_openness(landmarks: Float[ndarray, "T L 2"], open_percentile: float) -> Float[ndarray, "T 2"]:
    """Openness of each eye, 1 at the clip's open level: height over width of the lids (EAR)."""
    p1, p2, p3, p4, p5, p6 = np.moveaxis(landmarks[:, EYE_LANDMARKS], 2, 0)
    height = np.linalg.norm(p2 - p6, axis=-1) + np.linalg.norm(p3 - p5, axis=-1)
    ratio = height / (2 * np.linalg.norm(p1 - p4, axis=-1))
    return np.asarray(ratio / np.nanpercentile(ratio, open_percentile, axis=0))


def side_distances(landmarks: Float[ndarray, "T L 2"]) -> Float[ndarray, "T 2"]:
    """From the outer corner of each eye to the outline beside it, along the line of the eyes; negative if passed."""
    corners, outline = landmarks[:, _CORNERS], landmarks[:, _OUTLINE]
    across = corners[:, 0] - corners[:, 1]  # to the subject's left
    across = across / np.linalg.norm(across, axis=-1, keepdims=True)
    return np.asarray(np.einsum("tec,tc->te", outline - corners, across) * [1.0, -1.0])


def relative_difference(landmarks: Float[ndarray, "T L 2"]) -> Float[ndarray, " T"]:
    """|l - r| / (l + r)."""
    left, right = side_distances(landmarks).T
    return np.asarray(np.abs(left - right) / np.maximum(np.abs(left + right), 1e-6))


def self_occluded(landmarks: Float[ndarray, "T L 2"], settings: EyeVisibilitySettings) -> Bool[ndarray, "T 2"]:
    """The far eye of frames whose disparity is too large; none in frames without a face."""
    sides = side_distances(landmarks)
    far = sides < sides[:, ::-1]
    return np.asarray(far & (relative_difference(landmarks) > settings.disparity)[:, None])
