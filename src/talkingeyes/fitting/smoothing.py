"""Temporal smoothing of fitted gaze. All methods but the paper's work on gaze in space, (yaw, pitch) of both eyes.

Gaze in space is still between saccades, because the eyes counter-rotate the head. The eyes are conjugate: their mean
direction is smoothed by one of

    none        no smoothing; white noise of 0.3 px makes eyes move three to seven times too fast
    saccades    the L0 gradient term, which keeps steps, with a main-sequence saccade in place of each step
                (fixation_segmentation.py)

Their difference (vergence and the axes of the eyes) changes slowly and is smoothed by a wide Gaussian. The residual
within fixations is smoothed by a Gaussian and added back, so that drift and pursuit remain. In frames without visible
gaze it is held; `saccades` starts a gaze shift hidden by a blink at the start of the blink.

`convolution` is the paper's post-processing (section III-B.4) of a whole motion: eye-in-head is held over blinks, then
head, eyes and face are each convolved in time. The paper does not print its kernel; here it is a Gaussian.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field
from scipy.ndimage import gaussian_filter1d

from talkingeyes.core.motion import Motion
from talkingeyes.core.settings import Settings
from talkingeyes.fitting.fixation_segmentation import insert_saccades, noise_variance, piecewise_constant
from talkingeyes.fitting.gaps import hold_last, interpolate_gaps, runs

Positive = Annotated[float, Field(gt=0)]
HALF_WINDOW = 7  # frames in each of the two medians, before and after, between which a frame should lie


class BurstSettings(Settings):
    """Tracking errors: excursions of one eye by at least `min_amplitude_rad` that return within `frames` frames."""

    min_amplitude_rad: Positive
    frames: Annotated[int, Field(ge=0, lt=HALF_WINDOW)]


class NoSmoothing(Settings):
    """No smoothing."""

    kind: Literal["none"]


class PiecewiseConstantSettings(Settings):
    """`step_cost`: cost of a step in variances of the frame noise; `max_fixation_s`: longest segment without a step.

    `fixation_sigma_s`: sigma of the Gaussian inside fixations; `vergence_sigma_s`: of the Gaussian for the difference
    of the eyes.
    """

    kind: Literal["saccades"]
    step_cost: Positive
    max_fixation_s: Positive
    fixation_sigma_s: Positive
    vergence_sigma_s: Positive
    burst: BurstSettings


class ConvolutionSettings(Settings):
    """The paper's temporal convolution of head, eyes and face; sigma of the Gaussian in seconds."""

    kind: Literal["convolution"]
    sigma_s: Positive


GazeInSpaceSettings = NoSmoothing | PiecewiseConstantSettings
SmoothingSettings = Annotated[GazeInSpaceSettings | ConvolutionSettings, Field(discriminator="kind")]


def convolve_motion(motion: Motion, seen: Bool[ndarray, "T 2"], settings: ConvolutionSettings) -> Motion:
    """The paper's post-processing: hold the eye-in-head rotation of an eye that is not `seen`, then convolve."""
    held = np.stack([hold_last(motion.gaze[:, eye], seen[:, eye]) for eye in range(2)], axis=1)

    def convolved(values: Float[ndarray, "T C"]) -> Float[ndarray, "T C"]:
        return np.asarray(gaussian_filter1d(values, settings.sigma_s * motion.fps, axis=0, mode="nearest"))

    return replace(
        motion,
        head=convolved(motion.head),
        translation=convolved(motion.translation),
        gaze=convolved(held.reshape(-1, 6)).reshape(-1, 2, 3),
        jaw=convolved(motion.jaw),
        expression=convolved(motion.expression),
    )


def smooth_gaze(
    gaze_in_space_rad: Float[ndarray, "T 2 2"], seen: Bool[ndarray, "T 2"], fps: float, settings: GazeInSpaceSettings
) -> Float[ndarray, "T 2 2"]:
    """Smooth (yaw, pitch) of gaze in space of both eyes; gaze is held in frames where neither eye is `seen`."""
    if isinstance(settings, NoSmoothing):
        return hold_last(gaze_in_space_rad, np.asarray(seen.any(axis=1)))
    seen = seen & ~find_bursts(gaze_in_space_rad, seen, settings.burst)
    known = np.asarray(seen.any(axis=1))
    if not known.any():
        return np.zeros_like(gaze_in_space_rad)
    half = _half_difference(gaze_in_space_rad, seen, settings.vergence_sigma_s * fps)
    apart = np.stack([half, -half], axis=1)
    weight = seen[..., None].astype(np.float64)
    version = np.where(seen[..., None], gaze_in_space_rad - apart, 0.0).sum(axis=1) / np.maximum(
        weight.sum(axis=1), 1.0
    )
    return np.asarray(smooth_version(interpolate_gaps(version, known), known, fps, settings)[:, None] + apart)


def smooth_version(
    version: Float[ndarray, "T 2"], known: Bool[ndarray, " T"], fps: float, settings: PiecewiseConstantSettings
) -> Float[ndarray, "T 2"]:
    """Smooth the mean direction of both eyes."""
    cost = settings.step_cost * noise_variance(version, known)
    path = piecewise_constant(version, known, cost, max(2, round(settings.max_fixation_s * fps)))
    path = insert_saccades(version, known, path, fps)
    rest = _gaussian(version - path, known, settings.fixation_sigma_s * fps)
    return np.asarray(path + hold_last(rest, known))


def find_bursts(
    gaze_in_space_rad: Float[ndarray, "T 2 2"], seen: Bool[ndarray, "T 2"], settings: BurstSettings
) -> Bool[ndarray, "T 2"]:
    """Frames in which an eye leaves the line between the medians before and after it, and soon returns.

    Neither saccades nor fixations match: gaze stays at the target of a saccade, and fixations last longer.
    """
    flags = np.zeros(seen.shape, bool)
    for eye in range(2):
        known = seen[:, eye]
        track = np.pad(
            interpolate_gaps(gaze_in_space_rad[:, eye], known), ((HALF_WINDOW, HALF_WINDOW), (0, 0)), mode="edge"
        )
        windows = np.median(np.lib.stride_tricks.sliding_window_view(track, HALF_WINDOW, axis=0), axis=-1)
        frames = len(gaze_in_space_rad)
        before, after = windows[:frames], windows[HALF_WINDOW + 1 :]
        away = _distance_to_segment(track[HALF_WINDOW:-HALF_WINDOW], before, after) > settings.min_amplitude_rad
        for start, stop in runs(away):
            flags[start:stop, eye] = stop - start <= settings.frames
    return flags


def _half_difference(
    gaze_in_space_rad: Float[ndarray, "T 2 2"], seen: Bool[ndarray, "T 2"], sigma: float
) -> Float[ndarray, "T 2"]:
    """Half of left minus right, smoothed over the frames in which both eyes are visible."""
    both = np.asarray(seen.all(axis=1))
    if not both.any():
        return np.zeros((len(seen), 2))
    return _gaussian((gaze_in_space_rad[:, 0] - gaze_in_space_rad[:, 1]) / 2, both, sigma)


def _gaussian(values: Float[ndarray, "T C"], known: Bool[ndarray, " T"], sigma: float) -> Float[ndarray, "T C"]:
    """Normalised Gaussian convolution over the known frames; frames far from any known one are interpolated."""
    weight = gaussian_filter1d(known.astype(np.float64), sigma, mode="constant")
    total = gaussian_filter1d(np.where(known[:, None], values, 0.0), sigma, axis=0, mode="constant")
    reached = weight > 1e-6
    return interpolate_gaps(total / np.maximum(weight, 1e-12)[:, None], reached)


def _distance_to_segment(
    points: Float[ndarray, "T 2"], start: Float[ndarray, "T 2"], end: Float[ndarray, "T 2"]
) -> Float[ndarray, " T"]:
    """Distance of each point to the segment from `start` to `end`."""
    along = end - start
    share = np.sum((points - start) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-12)
    return np.asarray(np.linalg.norm(points - start - np.clip(share, 0, 1)[:, None] * along, axis=1))
