"""Blinks from the eye aspect ratio, EAR (Soukupova & Cech 2016), and the distribution of blink rates.

    EAR = (|p2 - p6| + |p3 - p5|) / (2 |p1 - p4|)

Looking down by 20 degrees lowers the ratio by a third, which is the classic false blink. The observed ratio is
therefore divided by the ratio that the fitted pose and gaze predict for lids that only follow gaze. Both are measured
from the ratio of shut lids (0.04, because their points do not lie on one line), and the quotient is divided by the open
level of the clip (a high percentile). The result is the opening: 1 when open and 0 when shut, for any head pose and
gaze.

A blink is a dip of the opening: the lids close from any starting level and open again within a second. The criterion is
the prominence of the dip (its depth below the lower of its two shoulders), not a fixed threshold. Squinting is
therefore not a blink, a blink with lowered lids is one, and two blinks in a row are two. Both eyes have to take part,
which excludes winks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field
from scipy.ndimage import median_filter
from scipy.signal import find_peaks

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze, gaze_to_angles
from talkingeyes.core.settings import Settings
from talkingeyes.fitting.gaps import interpolate_gaps
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS
from talkingeyes.head.landmarks import eye_landmarks, head_to_scene

Share = Annotated[float, Field(gt=0, lt=1)]
GAZE_MEDIAN_FRAMES = 5  # window of the median filter on gaze for the expected ratio
MAX_WIDENING = 0.5  # upper limit of the opening beyond the level that gaze predicts


class BlinkSettings(Settings):
    """A blink is a dip of at least `min_depth`, to below `max_opening`, as fractions of the clip's open level.

    A blink extends over the frames below `edge_ratio` times the level at its sides, which are searched for within
    `search_window_s`. Dips longer than `max_duration_s` are excluded. The percentile `open_percentile` of the openings
    of a clip is its open level.
    """

    open_percentile: Annotated[float, Field(ge=50, le=100)]
    min_depth: Share
    max_opening: Share
    edge_ratio: Share
    search_window_s: Annotated[float, Field(gt=0)]
    max_duration_s: Annotated[float, Field(gt=0)]


@dataclass(frozen=True)
class EyelidMotion:
    """Closure per eye (0 at the opening predicted from gaze, 1 shut), blinks as (start, stop), frames in blinks."""

    lid: Float[ndarray, "T 2"]
    blinks: tuple[tuple[int, int], ...]
    blinking: Bool[ndarray, " T"]


@dataclass(frozen=True)
class GaussianParameters:
    """Mean and standard deviation of values or of their logarithms."""

    mean: float
    sd: float


@dataclass(frozen=True)
class BlinkRateDistribution:
    """Blinks per minute over clips or speakers: a normal fit to all, a log-normal fit to those with blinks."""

    normal: GaussianParameters
    log_normal: GaussianParameters
    count: int
    without_blinks: int


def eye_aspect_ratio(landmarks: Float[ndarray, "T L 2"]) -> Float[ndarray, "T 2"]:
    """EAR of both eyes from landmarks in the order of `head.landmark_definitions.LANDMARK_NAMES`; NaN where hidden."""
    return aspect_ratio(landmarks[:, EYE_LANDMARKS])


def aspect_ratio(points: Float[ndarray, "T 2 6 C"]) -> Float[ndarray, "T 2"]:
    """EAR of the points p1 to p6 of both eyes."""
    p1, p2, p3, p4, p5, p6 = np.moveaxis(points, 2, 0)
    height = np.linalg.norm(p2 - p6, axis=-1) + np.linalg.norm(p3 - p5, axis=-1)
    return np.asarray(height / (2 * np.linalg.norm(p1 - p4, axis=-1)))


def expected_aspect_ratio(motion: Motion, camera: Camera, closure: float) -> Float[ndarray, "T 2"]:
    """EAR predicted from head pose and gaze, for lids that follow gaze and are closed by `closure`."""
    angles = median_filter(gaze_to_angles(motion.gaze), size=(GAZE_MEDIAN_FRAMES, 1, 1), mode="nearest")
    points = eye_landmarks(angles_to_gaze(angles), np.full(angles.shape[:2], closure)).reshape(len(motion), 12, 3)
    projected = camera.project(head_to_scene(points, motion.head, motion.translation))
    return aspect_ratio(projected.reshape(len(motion), 2, 6, 2))


def fit_lids(
    observed: Float[ndarray, "T 2"], expected: Float[ndarray, "T 2"], fps: float, settings: BlinkSettings
) -> EyelidMotion:
    """Closure and blinks from observed (NaN where hidden) and predicted EAR, both minus the EAR of shut eyes."""
    opening = np.stack([_opening(observed[:, eye] / expected[:, eye], settings) for eye in range(2)], axis=1)
    found = find_blinks(opening, fps, settings)
    blinking = np.zeros(len(opening), bool)
    for start, stop in found:
        blinking[start:stop] = True
    return EyelidMotion(1.0 - np.clip(opening, 0.0, 1.0 + MAX_WIDENING), found, blinking)


def find_blinks(opening: Float[ndarray, "T 2"], fps: float, settings: BlinkSettings) -> tuple[tuple[int, int], ...]:
    """Blinks as (start, stop), ordered and disjoint; adjacent blinks are split where the opening is largest."""
    mean, reach, longest = (
        opening.mean(axis=1),
        max(2, round(settings.search_window_s * fps)),
        round(settings.max_duration_s * fps),
    )
    found, _ = find_peaks(
        -mean,
        height=-settings.max_opening,
        prominence=settings.min_depth,
        plateau_size=(1, longest),
        wlen=2 * longest + 1,
    )
    lowest = [frame for frame in found.tolist() if _falls(opening, frame, reach) > settings.min_depth / 2]
    between = [first + int(np.argmax(mean[first:second])) for first, second in pairwise(lowest)]
    edges = [0, *between, len(mean)]
    spans = []
    for frame, low, high in zip(lowest, edges, edges[1:], strict=False):
        start = max(low, frame + 1 - _side(mean[max(0, frame - reach) : frame + 1][::-1], settings.edge_ratio))
        stop = min(high, frame + _side(mean[frame : frame + reach], settings.edge_ratio))
        if stop - start <= longest:
            spans.append((start, stop))
    return tuple(spans)


def _falls(opening: Float[ndarray, "T 2"], frame: int, reach: int) -> float:
    """How far the eyes close before a frame: the smaller value of the two eyes."""
    before = opening[max(frame - reach, 0) : frame + 1]
    return float((before.max(axis=0) - before[-1]).min())


def _side(outwards: Float[ndarray, " N"], share: float) -> int:
    """Number of frames, counted from the lowest, before the opening reaches a fraction of its maximum on this side."""
    above = np.flatnonzero(outwards >= share * outwards.max())
    return int(above[0]) if len(above) and above[0] else 1


def _opening(ratio: Float[ndarray, " T"], settings: BlinkSettings) -> Float[ndarray, " T"]:
    known = np.isfinite(ratio)
    if not known.any():
        return np.ones_like(ratio)
    level = np.percentile(ratio[known], settings.open_percentile)
    return interpolate_gaps(ratio[:, None] / level, known)[:, 0]


def blink_rate_distribution(blinks: Sequence[int], seconds: Sequence[float]) -> BlinkRateDistribution:
    """Distribution of blinks per minute, from counts and durations of clips or of speakers."""
    per_minute = np.asarray(blinks, np.float64) / (np.asarray(seconds, np.float64) / 60)
    logs = np.log(per_minute[per_minute > 0])
    return BlinkRateDistribution(
        normal=_gaussian_parameters(per_minute),
        log_normal=_gaussian_parameters(logs),
        count=len(per_minute),
        without_blinks=len(per_minute) - len(logs),
    )


def _gaussian_parameters(values: Float[ndarray, " N"]) -> GaussianParameters:
    return (
        GaussianParameters(float(values.mean()), float(values.std())) if len(values) else GaussianParameters(0.0, 0.0)
    )
