"""Eye contact: the fraction of time with gaze at the listener.

The model's fixations and their times stay. Fixations are ranked by the distance of gaze from the listener, smoothed in
time, so that the ones near the listener come first, in stretches of about two seconds. As many as make up the fraction
become contact; the last one is split to meet it. Fixations that must change are moved to the listener's face, or away
from it by amplitudes and directions of human gaze aversion (Lee, Badler & Badler 2002; Andrist et al. 2013). The head
follows. A larger fraction keeps all contact of a smaller one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import (
    GazeTrajectory,
    add_head_turns,
    fixations,
    shift_fixations,
    split_fixations,
)
from talkingeyes.audio.annotation import Span
from talkingeyes.physiology import saccades
from talkingeyes.synthesis.gaze_aversion import AversionCause
from talkingeyes.synthesis.gaze_shifts import FACE_RADIUS_RAD, octant_probabilities

# Values without a source are choices of this project.
# Gaze within this of the point between the listener's eyes is contact (evaluation/detectors has the same limit).
CONTACT_RAD = float(np.radians(4.0))
# A fixation nearer than NEAR is contact as it is; one farther than FAR is averted as it is.
NEAR_RAD, FAR_RAD = float(np.radians(2.8)), float(np.radians(6.0))
EYE_CONTACT_STREAM = 2
MIN_AVERSION_DEG, MAX_AVERSION_DEG = 7.0, 20.0
AVERSION_S = 2.0
SMOOTHING_S = 0.2
MIN_FIXATION_PART_S = 0.3
HEAD_THRESHOLD_RAD, HEAD_GAIN = float(np.radians(5.0)), 0.4


def apply_eye_contact(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Set the fraction of time with gaze at the listener, where the controls give one."""
    if context.controls.eye_contact is None:
        return trajectory
    return set_eye_contact(trajectory, context.controls.eye_contact, context, EYE_CONTACT_STREAM)


def set_eye_contact(
    trajectory: GazeTrajectory,
    fraction: float,
    context: AnimationContext,
    stream: int,
    spans: Sequence[Span] | None = None,
    cause: AversionCause = "intimacy",
) -> GazeTrajectory:
    """Set the fraction of the time, or of the given spans, with gaze at the listener.

    `stream` seeds the aversions, whose directions are those of their `cause`.
    """
    listener = line_of_sight.target_direction_rad(trajectory.head, context.listener(trajectory.times_s))
    offset = line_of_sight.cyclopean_line_of_sight_rad(trajectory.gaze_in_space_rad) - listener
    near = gaussian_filter1d(np.hypot(*offset.T), SMOOTHING_S * trajectory.fps, mode="nearest")
    trajectory = split_fixations(trajectory, _span_edges(trajectory, spans))
    inside = _inside(trajectory, spans)
    in_contact, split_s = _select_contact(trajectory, near, fraction, inside)
    if split_s is not None:
        trajectory = split_fixations(trajectory, [split_s])
        inside = _inside(trajectory, spans)
        in_contact, _ = _select_contact(trajectory, near, fraction, inside)
    return _apply_offsets(trajectory, offset, in_contact, inside, context.stream(stream), cause)


def eye_contact_fraction(
    head: Float[ndarray, "T 3"], gaze_in_space_rad: Float[ndarray, "T 2 2"], listener: Float[ndarray, "T 4"]
) -> float:
    """The fraction of frames in which the line of sight is within `CONTACT_RAD` of the listener."""
    offset = line_of_sight.cyclopean_line_of_sight_rad(gaze_in_space_rad) - line_of_sight.target_direction_rad(
        head, listener
    )
    return float((np.hypot(*offset.T) <= CONTACT_RAD).mean())


def _span_edges(trajectory: GazeTrajectory, spans: Sequence[Span] | None) -> list[float]:
    """Times at which a span begins or ends well inside a fixation: gaze may move there."""
    found = fixations(trajectory, trajectory.cyclopean_rad)
    edges = [edge for span in spans or () for edge in (span.start_s, span.end_s)]
    inner_edges = []
    for edge in edges:
        index = int(np.searchsorted(found.start_s, edge, side="right")) - 1
        if index >= 0 and found.start_s[index] + MIN_FIXATION_PART_S < edge < found.end_s[index] - MIN_FIXATION_PART_S:
            inner_edges.append(edge)
    return inner_edges


def _inside(trajectory: GazeTrajectory, spans: Sequence[Span] | None) -> Bool[ndarray, " K"]:
    """Whether the middle of each fixation is in a span."""
    found = fixations(trajectory, trajectory.cyclopean_rad)
    if spans is None:
        return np.ones(len(found.start_s), bool)
    middle = (found.start_s + found.end_s) / 2.0
    return np.array([any(span.start_s <= time < span.end_s for span in spans) for time in middle], bool)


def _select_contact(
    trajectory: GazeTrajectory, near: Float[ndarray, " T"], fraction: float, inside: Bool[ndarray, " K"]
) -> tuple[Bool[ndarray, " K"], float | None]:
    """Which fixations become contact, and when the last one should be split to meet the fraction."""
    found = fixations(trajectory, np.stack([near, near], axis=-1))
    length = (found.end_s - found.start_s) * inside
    order = np.argsort(np.where(inside, found.location_rad[:, 0], np.inf), kind="stable")
    wanted = fraction * length.sum()
    before = np.cumsum(length[order]) - length[order]
    in_contact = np.zeros(len(length), bool)
    left = wanted - before
    in_contact[order] = (left >= length[order] / 2.0) & inside[order] & (left > 0)
    if fraction in (0.0, 1.0):
        in_contact = inside & (fraction == 1.0)
        return in_contact, None
    last = order[np.clip(np.searchsorted(before, wanted, side="right") - 1, 0, len(order) - 1)]
    rest = wanted - before[order == last][0]
    fits = MIN_FIXATION_PART_S <= rest <= length[last] - MIN_FIXATION_PART_S
    return in_contact, float(found.start_s[last] + rest) if fits else None


def _apply_offsets(
    trajectory: GazeTrajectory,
    offset: Float[ndarray, "T 2"],
    in_contact: Bool[ndarray, " K"],
    inside: Bool[ndarray, " K"],
    seeds: Sequence[int],
    cause: AversionCause,
) -> GazeTrajectory:
    found = fixations(trajectory, offset)
    offsets = np.zeros_like(found.location_rad)
    aversion_end, away = -np.inf, np.zeros(2)
    for index, location in enumerate(found.location_rad):
        if not inside[index]:
            continue
        rng = np.random.default_rng([*seeds, int(found.start_s[index] * 1000)])
        far = float(np.hypot(*location))
        if in_contact[index] and far > NEAR_RAD:
            offsets[index] = sample_within_face_rad(rng) - location
        elif not in_contact[index] and far < FAR_RAD:
            if found.start_s[index] > aversion_end or in_contact[index - 1]:
                away, aversion_end = sample_aversion_rad(rng, cause), found.start_s[index] + AVERSION_S
            offsets[index] = away  # scanning within the face becomes scanning about the new location
    return add_head_turns(shift_fixations(trajectory, offsets), found.start_s, offsets, HEAD_THRESHOLD_RAD, HEAD_GAIN)


def sample_within_face_rad(rng: np.random.Generator) -> Float[ndarray, " 2"]:
    """Sample where in the listener's face a fixation lies, from between the eyes."""
    return np.asarray(np.clip(0.4 * FACE_RADIUS_RAD * rng.standard_normal(2), -NEAR_RAD / 2, NEAR_RAD / 2))


def sample_aversion_rad(rng: np.random.Generator, cause: AversionCause = "intimacy") -> Float[ndarray, " 2"]:
    """Sample amplitude and direction of a gaze aversion, from between the listener's eyes."""
    size = saccades.sample_amplitudes_rad(1, rng, MIN_AVERSION_DEG, MAX_AVERSION_DEG)
    step = saccades.sample_directions(1, rng, octant_probabilities(cause))[0]
    return np.asarray(size * step / np.hypot(*step))
