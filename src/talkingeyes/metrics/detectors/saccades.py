"""Saccades in gaze in space, by the rule that suits the frame rate.

Below 60 fps a saccade is one or two steps between frames: displacement, I-VT on steps of 25 degrees a second (1 degree
a frame at 25 fps) or more, neighbouring steps joined, amplitude their sum (Salvucci & Goldberg 2000; FACTS, section 9).
From 60 to 200 fps I-VT at 30 degrees a second. From 200 fps Engbert & Kliegl (2003): velocities over five samples,

    v_n = (x_{n+2} + x_{n+1} - x_{n-1} - x_{n-2}) / (6 dt),   sigma^2 = median(v^2) - median(v)^2,

outside the ellipse of 6 sigma for 12 ms or longer. No rule has a threshold below its noise: I-VT takes five robust
standard deviations of the steps if that is more, and Engbert & Kliegl's ellipse has a least size, because rendered
motion has no noise at all. On eye-in-head the counter-rotation under the head makes false saccades: hand over gaze in
space, R(head) R(eye), the mean direction of both eyes (`rotation.conjugate`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.metrics.detectors.signal import MEDIAN_OF_RAYLEIGH, Runs, runs, seen
from talkingeyes.physiology import saccades as law

VELOCITY_FROM_FPS = 60.0  # below, durations are not measured: frames do not hold them
ENGBERT_KLIEGL_FROM_FPS = 200.0
DISPLACEMENT_DEG_S, DISPLACEMENT_EDGE_DEG_S = 25.0, 5.0
VELOCITY_DEG_S, VELOCITY_EDGE_DEG_S = 30.0, 10.0
NOISE_SIGMAS, EDGE_SIGMAS = 5.0, 3.0
LEAST_S = 0.012  # Engbert & Kliegl's; I-VT too drops what is shorter, where frames are closer than that
ECHO_S, ECHO_SHARE = 0.06, 0.5
ENGBERT_KLIEGL_LAMBDA = 6.0
ENGBERT_KLIEGL_LEAST_DEG_S = 15.0
FIVE_SAMPLES_FPS = 500.0  # above this rate the five samples are spread, so that they span 8 ms


@dataclass(frozen=True)
class Saccades:
    """N saccades in order of time. Angles are (yaw to the subject's left, pitch up) of gaze in space.

    Below `VELOCITY_FROM_FPS` the duration is that of the main sequence for the amplitude: only its middle is seen.
    """

    onset_s: Float[ndarray, " N"]
    offset_s: Float[ndarray, " N"]
    start_rad: Float[ndarray, "N 2"]
    displacement_rad: Float[ndarray, "N 2"]
    peak_speed_deg_s: Float[ndarray, " N"]

    def __len__(self) -> int:
        return len(self.onset_s)

    @property
    def amplitude_deg(self) -> Float[ndarray, " N"]:
        """Angle between where it starts and where it ends."""
        return np.asarray(np.degrees(np.linalg.norm(self._flat_rad, axis=1)))

    @property
    def duration_s(self) -> Float[ndarray, " N"]:
        """From onset to offset."""
        return np.asarray(self.offset_s - self.onset_s)

    @property
    def direction_rad(self) -> Float[ndarray, " N"]:
        """0 to the subject's left, pi/2 up, pi to the subject's right, -pi/2 down."""
        flat = self._flat_rad
        return np.asarray(np.arctan2(flat[:, 1], flat[:, 0]))

    @property
    def _flat_rad(self) -> Float[ndarray, "N 2"]:
        return flat_steps(self.start_rad, self.displacement_rad)


@dataclass(frozen=True)
class Rule:
    """I-VT with two thresholds: a saccade goes beyond `core_deg_s` and lasts as long as it is beyond `edge_deg_s`."""

    core_deg_s: float
    edge_deg_s: float


DISPLACEMENT = Rule(DISPLACEMENT_DEG_S, DISPLACEMENT_EDGE_DEG_S)
VELOCITY = Rule(VELOCITY_DEG_S, VELOCITY_EDGE_DEG_S)


def detect_saccades(
    gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, valid: Bool[ndarray, " T"] | None = None
) -> Saccades:
    """Saccades of gaze in space (yaw, pitch). Frames that are not valid take no part. Raises InputError."""
    known = seen("gaze in space", gaze_in_space_rad, fps, valid)
    if fps >= ENGBERT_KLIEGL_FROM_FPS:
        return engbert_kliegl(gaze_in_space_rad, fps, known)
    return velocity_threshold(gaze_in_space_rad, fps, known, DISPLACEMENT if fps < VELOCITY_FROM_FPS else VELOCITY)


def velocity_threshold(
    gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, known: Bool[ndarray, " T"], rule: Rule
) -> Saccades:
    """I-VT on steps between frames; a reversal starts another saccade."""
    steps = flat_steps(gaze_in_space_rad[:-1], np.diff(gaze_in_space_rad, axis=0))
    both = known[:-1] & known[1:]
    steps = np.where(both[:, None], steps, 0.0)
    speed = np.degrees(np.hypot(steps[:, 0], steps[:, 1])) * fps
    noise = np.median(speed[both]) / MEDIAN_OF_RAYLEIGH if both.any() else 0.0
    core, edge = max(rule.core_deg_s, NOISE_SIGMAS * noise), max(rule.edge_deg_s, EDGE_SIGMAS * noise)
    reversal = np.zeros(len(speed), bool)
    reversal[1:] = (steps[1:] * steps[:-1]).sum(axis=1) < 0
    found = runs(speed >= edge, reversal)
    if len(found):
        found = found.where(np.maximum.reduceat(speed, found.first) >= core)
    found = found.where(found.last - found.first + 1 >= LEAST_S * fps)
    found = _without_echoes(gaze_in_space_rad, fps, Runs(found.first, found.last + 1))
    return _timed(gaze_in_space_rad, speed, fps, found, measured=fps >= VELOCITY_FROM_FPS)


def engbert_kliegl(gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, known: Bool[ndarray, " T"]) -> Saccades:
    """Velocities over five samples outside an ellipse of six robust standard deviations for 12 ms or longer."""
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
    velocity = np.degrees(np.where(_all_around(known, reach)[:, None], velocity, np.nan))
    median = np.nanmedian(velocity, axis=0)
    sigma = np.sqrt(np.maximum(np.nanmedian(velocity**2, axis=0) - median**2, 0.0))
    radius = np.maximum(ENGBERT_KLIEGL_LAMBDA * sigma, ENGBERT_KLIEGL_LEAST_DEG_S)
    with np.errstate(invalid="ignore"):
        outside = ((velocity / radius) ** 2).sum(axis=1) > 1.0
    found = runs(outside)
    found = found.where(found.last - found.first + 1 >= LEAST_S * fps)
    found = _without_echoes(gaze_in_space_rad, fps, found)
    speed = np.nan_to_num(np.hypot(velocity[:, 0], velocity[:, 1]))
    return _at_samples(gaze_in_space_rad, speed, fps, found)


def flat_steps(start_rad: Float[ndarray, "N 2"], step_rad: Float[ndarray, "N 2"]) -> Float[ndarray, "N 2"]:
    """Steps of (yaw, pitch) as angles of gaze: a degree of yaw is less of an angle when gaze is up or down."""
    shrink = np.cos(start_rad[:, 1] + step_rad[:, 1] / 2)
    return np.stack([step_rad[:, 0] * shrink, step_rad[:, 1]], axis=1)


def _without_echoes(gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, found: Runs) -> Runs:
    """Saccades without what follows a larger one at once: eyes rest for 100 ms or more between two of them.

    What is half as large or less within 60 ms of the end is a post-saccadic oscillation (experts label it apart).
    """
    if len(found) < 2:
        return found
    size = np.linalg.norm(gaze_in_space_rad[found.last] - gaze_in_space_rad[found.first], axis=1)
    echo = np.zeros(len(found), bool)
    echo[1:] = ((found.first[1:] - found.last[:-1]) <= ECHO_S * fps) & (size[1:] <= ECHO_SHARE * size[:-1])
    return found.where(~echo)


def _timed(
    gaze_in_space_rad: Float[ndarray, "T 2"], speed_deg_s: Float[ndarray, " S"], fps: float, found: Runs, measured: bool
) -> Saccades:
    """Saccades from one frame to another, placed by the moments of their movement.

    When the movement is half done, on average, is known to a fraction of a frame, whereas when it starts between two
    frames is not. So onset and offset lie around the mean time, as far apart as the spread says (`measured`; less
    Sheppard's dt^2 / 12 for sampling), or where frames are too few for that, as the main sequence says.
    """
    if not len(found):
        return _none()
    stop = found.last
    displacement = gaze_in_space_rad[stop] - gaze_in_space_rad[found.first]
    amplitude = np.linalg.norm(flat_steps(gaze_in_space_rad[found.first], displacement), axis=1)
    time_s = (np.arange(len(speed_deg_s)) + 0.5) / fps
    powers = np.stack([speed_deg_s, speed_deg_s * time_s, speed_deg_s * time_s**2])
    summed = np.concatenate([np.zeros((3, 1)), np.cumsum(powers, axis=1)], axis=1)
    weight, first_moment, second_moment = summed[:, stop] - summed[:, found.first]
    middle_s = first_moment / weight
    profile = law.progress_moments(amplitude)
    duration = law.duration_s(amplitude)
    if measured:
        variance = second_moment / weight - middle_s**2 - 1.0 / (12.0 * fps**2)
        duration = np.maximum(np.sqrt(np.maximum(variance, 0.0)) / profile.deviation, 1.0 / fps)
    onset = middle_s - duration * profile.mean
    return Saccades(
        onset_s=onset,
        offset_s=onset + duration,
        start_rad=gaze_in_space_rad[found.first],
        displacement_rad=displacement,
        peak_speed_deg_s=_peaks(speed_deg_s, found.first, found.last - 1),
    )


def _at_samples(
    gaze_in_space_rad: Float[ndarray, "T 2"], speed_deg_s: Float[ndarray, " T"], fps: float, found: Runs
) -> Saccades:
    """Saccades of runs of samples."""
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


def _all_around(known: Bool[ndarray, " T"], reach: int) -> Bool[ndarray, " T"]:
    """Whether all frames within `reach` are known."""
    unknown = np.concatenate([[0], np.cumsum(~known)])
    index = np.arange(len(known))
    low, high = np.maximum(index - reach, 0), np.minimum(index + reach + 1, len(known))
    return np.asarray((unknown[high] == unknown[low]) & (index >= reach) & (index < len(known) - reach))


def _none() -> Saccades:
    return Saccades(np.zeros(0), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
