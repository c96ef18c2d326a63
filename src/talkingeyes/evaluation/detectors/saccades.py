"""Detection of saccades in gaze in space, by a method that depends on the frame rate.

Below 60 fps a saccade spans one or two steps between frames. The displacement rule is I-VT on steps of at least 25
degrees per second (1 degree per frame at 25 fps); neighbouring steps are joined and the amplitude is their sum
(Salvucci & Goldberg 2000). From 60 to 200 fps it is I-VT at 30 degrees per second, on single steps or over 25 ms where
noise hides the threshold. From 200 fps it is Engbert & Kliegl (2003): velocities over five samples,

    v_n = (x_{n+2} + x_{n+1} - x_{n-1} - x_{n-2}) / (6 dt),   sigma^2 = median(v^2) - median(v)^2,

outside the ellipse of 6 sigma for 12 ms or longer. No threshold lies below the noise: I-VT uses five robust standard
deviations of the steps if that is larger. The ellipse of Engbert & Kliegl has a minimum size, because rendered motion
has no noise. The input must be gaze in space, R(head) R(eye), the mean direction of both eyes
(`rotation.cyclopean_gaze`): in eye-in-head angles, the counter-rotation during head movement produces false saccades.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.evaluation.detectors.signal import RAYLEIGH_MEDIAN, Runs, TimedEvents, runs, valid_frames
from talkingeyes.physiology import saccades as main_sequence_model

MIN_DURATION_FPS = 60.0  # below, frames are too few to measure durations
MIN_ENGBERT_KLIEGL_FPS = 200.0
DISPLACEMENT_DEG_S, DISPLACEMENT_EDGE_DEG_S = 25.0, 5.0
VELOCITY_DEG_S, VELOCITY_EDGE_DEG_S = 30.0, 10.0
NOISE_SIGMAS, EDGE_SIGMAS = 5.0, 3.0
MIN_DURATION_S = 0.012  # of Engbert & Kliegl; also for I-VT, where frames are closer than that
MIN_STEP_FRACTION = 0.5  # least net displacement of a saccade, as a fraction of one step at the threshold
OSCILLATION_S, OSCILLATION_FRACTION = 0.06, 0.5
ENGBERT_KLIEGL_LAMBDA = 6.0
ENGBERT_KLIEGL_MIN_DEG_S = 15.0
FIVE_SAMPLES_FPS = 500.0  # above this rate the five samples are spread, so that they span 8 ms


@dataclass(frozen=True)
class Saccades(TimedEvents):
    """N saccades in order of time. Angles are (yaw to the subject's left, pitch up) of gaze in space.

    Below `MIN_DURATION_FPS` only the time of the middle is measured; the duration is that of the main sequence.
    """

    start_rad: Float[ndarray, "N 2"]
    displacement_rad: Float[ndarray, "N 2"]
    peak_speed_deg_s: Float[ndarray, " N"]

    @property
    def amplitude_deg(self) -> Float[ndarray, " N"]:
        """Angle between the start and end directions."""
        return np.asarray(np.degrees(np.linalg.norm(self._flat_rad, axis=1)))

    @property
    def direction_rad(self) -> Float[ndarray, " N"]:
        """0 to the subject's left, pi/2 up, pi to the subject's right, -pi/2 down."""
        flat = self._flat_rad
        return np.asarray(np.arctan2(flat[:, 1], flat[:, 0]))

    @property
    def _flat_rad(self) -> Float[ndarray, "N 2"]:
        return angular_steps(self.start_rad, self.displacement_rad)


@dataclass(frozen=True)
class VelocityThresholds:
    """I-VT with two thresholds: a saccade exceeds `peak_deg_s` and lasts while it is above `edge_deg_s`.

    Velocity is computed on single steps, or over `span_s` where the noise of single steps hides the threshold.
    """

    peak_deg_s: float
    edge_deg_s: float
    span_s: float


DISPLACEMENT = VelocityThresholds(DISPLACEMENT_DEG_S, DISPLACEMENT_EDGE_DEG_S, span_s=0.0)
VELOCITY = VelocityThresholds(VELOCITY_DEG_S, VELOCITY_EDGE_DEG_S, span_s=0.025)


def detect_saccades(
    gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, valid: Bool[ndarray, " T"] | None = None
) -> Saccades:
    """Detect saccades of gaze in space (yaw, pitch). Invalid frames are excluded. Raises InputError."""
    known = valid_frames("gaze in space", gaze_in_space_rad, fps, valid)
    if fps >= MIN_ENGBERT_KLIEGL_FPS:
        return detect_saccades_ek(gaze_in_space_rad, fps, known)
    return detect_saccades_ivt(gaze_in_space_rad, fps, known, DISPLACEMENT if fps < MIN_DURATION_FPS else VELOCITY)


def detect_saccades_ivt(
    gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, known: Bool[ndarray, " T"], thresholds: VelocityThresholds
) -> Saccades:
    """Detect saccades with I-VT on single steps or over the thresholds' span; a reversal starts a new saccade."""
    steps = _steps(gaze_in_space_rad, fps, known, 1)
    if NOISE_SIGMAS * steps.noise_deg_s > thresholds.peak_deg_s and round(thresholds.span_s * fps) > 1:
        steps = _steps(gaze_in_space_rad, fps, known, round(thresholds.span_s * fps))
    speed, noise = steps.speed_deg_s, steps.noise_deg_s
    core, edge = max(thresholds.peak_deg_s, NOISE_SIGMAS * noise), max(thresholds.edge_deg_s, EDGE_SIGMAS * noise)
    reversal = np.zeros(len(speed), bool)
    reversal[1:] = (steps.step_rad[1:] * steps.step_rad[:-1]).sum(axis=1) < 0
    found = runs(speed >= edge, reversal)
    if len(found):
        found = found.where(np.maximum.reduceat(speed, found.first) >= core)
    found = Runs(found.first, found.last + steps.span)
    amplitude = np.linalg.norm(gaze_in_space_rad[found.last] - gaze_in_space_rad[found.first], axis=1)
    # Fast movement that returns to its start is not a saccade.
    goes = np.degrees(amplitude) >= MIN_STEP_FRACTION * core * steps.span / fps
    found = found.where(goes & (found.last - found.first >= MIN_DURATION_S * fps))
    found = _without_oscillations(gaze_in_space_rad, fps, found)
    return _timed(gaze_in_space_rad, fps, found, measured=fps >= MIN_DURATION_FPS)


@dataclass(frozen=True)
class Steps:
    """Displacements from each frame to the one `span` later (0 if any frame between is invalid), and their noise."""

    span: int
    step_rad: Float[ndarray, "S 2"]
    speed_deg_s: Float[ndarray, " S"]
    noise_deg_s: float  # robust standard deviation on one axis


def _steps(gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, known: Bool[ndarray, " T"], span: int) -> Steps:
    steps = angular_steps(gaze_in_space_rad[:-span], gaze_in_space_rad[span:] - gaze_in_space_rad[:-span])
    whole = _stretches(known, span)
    steps = np.where(whole[:, None], steps, 0.0)
    speed = np.degrees(np.hypot(steps[:, 0], steps[:, 1])) * (fps / span)
    noise = float(np.median(speed[whole])) / RAYLEIGH_MEDIAN if whole.any() else 0.0
    return Steps(span, steps, speed, noise)


def detect_saccades_ek(gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, known: Bool[ndarray, " T"]) -> Saccades:
    """Detect saccades with Engbert & Kliegl: velocity outside an ellipse of 6 sigma for 12 ms or longer."""
    stride = max(1, round(fps / FIVE_SAMPLES_FPS))
    reach = 2 * stride
    flat = gaze_in_space_rad * np.stack([np.cos(gaze_in_space_rad[:, 1]), np.ones(len(gaze_in_space_rad))], axis=1)
    velocity = np.zeros_like(flat)
    middle = slice(reach, len(flat) - reach)
    velocity[middle] = (
        flat[2 * reach :]
        + flat[reach + stride : len(flat) - stride]
        - flat[stride : len(flat) - reach - stride]
        - flat[: len(flat) - 2 * reach]
    ) * (fps / (6 * stride))
    whole = np.zeros(len(flat), bool)
    whole[middle] = _stretches(known, 2 * reach)
    velocity = np.degrees(np.where(whole[:, None], velocity, np.nan))
    median = np.nanmedian(velocity, axis=0)
    sigma = np.sqrt(np.maximum(np.nanmedian(velocity**2, axis=0) - median**2, 0.0))
    radius = np.maximum(ENGBERT_KLIEGL_LAMBDA * sigma, ENGBERT_KLIEGL_MIN_DEG_S)
    with np.errstate(invalid="ignore"):
        outside = ((velocity / radius) ** 2).sum(axis=1) > 1.0
    found = runs(outside)
    found = found.where(found.last - found.first + 1 >= MIN_DURATION_S * fps)
    found = _without_oscillations(gaze_in_space_rad, fps, found)
    speed = np.nan_to_num(np.hypot(velocity[:, 0], velocity[:, 1]))
    return _at_samples(gaze_in_space_rad, speed, fps, found)


def angular_steps(start_rad: Float[ndarray, "N 2"], step_rad: Float[ndarray, "N 2"]) -> Float[ndarray, "N 2"]:
    """Convert steps of (yaw, pitch) to angles of gaze: yaw is scaled by the cosine of pitch."""
    shrink = np.cos(start_rad[:, 1] + step_rad[:, 1] / 2)
    return np.stack([step_rad[:, 0] * shrink, step_rad[:, 1]], axis=1)


def _without_oscillations(gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, found: Runs) -> Runs:
    """Drop post-saccadic oscillations: eyes rest for at least 100 ms between two saccades.

    An oscillation follows within 60 ms of the end of a saccade and has at most half its amplitude; expert labels
    keep it separate.
    """
    reach = OSCILLATION_S * fps
    if not (found.first[1:] - found.last[:-1] <= reach).any():
        return found
    size = np.linalg.norm(gaze_in_space_rad[found.last] - gaze_in_space_rad[found.first], axis=1)
    kept: list[int] = []
    for index in range(len(found)):
        echo = kept and found.first[index] - found.last[kept[-1]] <= reach
        if not (echo and size[index] <= OSCILLATION_FRACTION * size[kept[-1]]):
            kept.append(index)
    return Runs(found.first[kept], found.last[kept])


def _timed(gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, found: Runs, measured: bool) -> Saccades:
    """Build saccades from runs of frames, timed by the moments of their movement.

    The mean time of the movement is known to a fraction of a frame, while its start between two frames is not. Onset
    and offset are placed around the mean time. Their distance follows from the standard deviation of the movement
    (`measured`; with Sheppard's correction of dt^2 / 12 for sampling) or, where frames are too few, from the main
    sequence.
    """
    if not len(found):
        return _none()
    start = gaze_in_space_rad[found.first]
    displacement = gaze_in_space_rad[found.last] - start
    whole = angular_steps(start, displacement)
    amplitude = np.linalg.norm(whole, axis=1)
    counts = found.last - found.first
    owner = np.repeat(np.arange(len(found)), counts)
    step = np.arange(counts.sum()) + np.repeat(found.first - np.cumsum(counts) + counts, counts)
    each = angular_steps(gaze_in_space_rad[step], gaze_in_space_rad[step + 1] - gaze_in_space_rad[step])
    # Projection of each step on the saccade: noise across it is excluded, and noise along it cancels.
    share = (each * whole[owner]).sum(axis=1) / (amplitude**2)[owner]
    time_s = (step + 0.5) / fps
    middle_s = np.bincount(owner, share * time_s) / np.bincount(owner, share)
    profile = main_sequence_model.progress_moments(amplitude)
    duration = main_sequence_model.duration_s(amplitude)
    if measured:
        variance = np.bincount(owner, share * (time_s - middle_s[owner]) ** 2) - 1.0 / (12.0 * fps**2)
        duration = np.maximum(np.sqrt(np.maximum(variance, 0.0)) / profile.deviation, 1.0 / fps)
    onset = middle_s - duration * profile.mean
    return Saccades(
        onset_s=onset,
        offset_s=onset + duration,
        start_rad=start,
        displacement_rad=displacement,
        peak_speed_deg_s=np.maximum.reduceat(np.hypot(*each.T), np.cumsum(counts) - counts) * np.degrees(fps),
    )


def _at_samples(
    gaze_in_space_rad: Float[ndarray, "T 2"], speed_deg_s: Float[ndarray, " T"], fps: float, found: Runs
) -> Saccades:
    """Build saccades from runs of samples, with onset and offset at samples."""
    if not len(found):
        return _none()
    start = gaze_in_space_rad[found.first]
    return Saccades(
        onset_s=found.first / fps,
        offset_s=found.last / fps,
        start_rad=start,
        displacement_rad=gaze_in_space_rad[found.last] - start,
        peak_speed_deg_s=_peaks(speed_deg_s, found.first, found.last),
    )


def _peaks(
    speed_deg_s: Float[ndarray, " S"], first: Int[ndarray, " N"], last: Int[ndarray, " N"]
) -> Float[ndarray, " N"]:
    edges = np.minimum(np.stack([first, last + 1], axis=1).ravel(), len(speed_deg_s) - 1)
    return np.asarray(np.maximum(np.maximum.reduceat(speed_deg_s, edges)[::2], speed_deg_s[last]))


def _stretches(known: Bool[ndarray, " T"], reach: int) -> Bool[ndarray, " S"]:
    """Whether frames n to n + reach are all known, for each n with `reach` frames after it."""
    unknown = np.concatenate([[0], np.cumsum(~known)])
    return np.asarray(unknown[reach + 1 :] == unknown[: -reach - 1])


def _none() -> Saccades:
    return Saccades(np.zeros(0), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
