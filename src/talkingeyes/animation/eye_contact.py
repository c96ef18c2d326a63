"""Eye contact as a share of time: which fixations are at the listener and which are averted is chosen anew.

The model's own fixations and their times stay. They are ranked by how far from the listener gaze is about them, so that
those which the model holds near come first, in stretches of some two seconds; as many as make up the share are at
the listener's face, the last one cut in two to meet it. What has to move is re-aimed: into the face, or away in the
amplitudes and directions of people who avert their gaze (Lee, Badler & Badler 2002; Andrist et al. 2013). The head goes
along. A larger share keeps all contact that a smaller one has.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.gaze_trajectory import (
    GazeTrajectory,
    add_head_turns,
    fixations,
    shift_fixations,
    split_fixations,
)
from talkingeyes.audio.annotation import Span
from talkingeyes.physiology import saccades
from talkingeyes.synthesis.gaze_shifts import FACE_RADIUS_RAD, octant_probabilities

# Gaze within this of the point between the listener's eyes is contact (as metrics.detectors.gaze_states has it).
CONTACT_RAD = float(np.radians(4.0))
# Fixations this near need not move to be contact, those this far need not move to be averted.
NEAR_RAD, FAR_RAD = float(np.radians(2.8)), float(np.radians(6.0))
MIN_AVERSION_DEG, MAX_AVERSION_DEG = 7.0, 20.0
AVERSION_S = 2.0
SMOOTHING_S = 0.2
MIN_FIXATION_PART_S = 0.3
HEAD_THRESHOLD_RAD, HEAD_GAIN = float(np.radians(5.0)), 0.4


def apply_eye_contact(
    trajectory: GazeTrajectory,
    listener_m: Float[ndarray, "T 3"],
    share: float,
    seeds: Sequence[int],
    spans: Sequence[Span] | None = None,
) -> GazeTrajectory:
    """The course with gaze at the listener for a share of the time, or of the spans that are given."""
    listener = line_of_sight.point_direction_rad(trajectory.head, listener_m)
    offset = line_of_sight.cyclopean_line_of_sight_rad(trajectory.gaze_in_space_rad) - listener
    near = gaussian_filter1d(np.hypot(*offset.T), SMOOTHING_S * trajectory.fps, mode="nearest")
    cuts = _cuts(trajectory, spans)
    trajectory = split_fixations(trajectory, cuts)
    inside = _inside(trajectory, spans)
    in_contact, cut = _select_contact(trajectory, near, share, inside)
    if cut is not None:
        trajectory = split_fixations(trajectory, [cut])
        inside = _inside(trajectory, spans)
        in_contact, _ = _select_contact(trajectory, near, share, inside)
    return _apply_offsets(trajectory, offset, in_contact, inside, seeds)


def eye_contact_fraction(
    head: Float[ndarray, "T 3"], gaze_in_space_rad: Float[ndarray, "T 2 2"], listener_m: Float[ndarray, "T 3"]
) -> float:
    """The share of frames in which the line of sight is within `CONTACT_RAD` of the listener."""
    offset = line_of_sight.cyclopean_line_of_sight_rad(gaze_in_space_rad) - line_of_sight.point_direction_rad(
        head, listener_m
    )
    return float((np.hypot(*offset.T) <= CONTACT_RAD).mean())


def _cuts(trajectory: GazeTrajectory, spans: Sequence[Span] | None) -> list[float]:
    """Where spans begin and end inside a long enough fixation: gaze may change its place there."""
    found = fixations(trajectory, trajectory.cyclopean_rad)
    edges = [edge for span in spans or () for edge in (span.start_s, span.end_s)]
    cuts = []
    for edge in edges:
        index = int(np.searchsorted(found.start_s, edge, side="right")) - 1
        if index >= 0 and found.start_s[index] + MIN_FIXATION_PART_S < edge < found.end_s[index] - MIN_FIXATION_PART_S:
            cuts.append(edge)
    return cuts


def _inside(trajectory: GazeTrajectory, spans: Sequence[Span] | None) -> Bool[ndarray, " K"]:
    """Whether each fixation is in a span."""
    found = fixations(trajectory, trajectory.cyclopean_rad)
    if spans is None:
        return np.ones(len(found.start_s), bool)
    middle = (found.start_s + found.end_s) / 2.0
    return np.array([any(span.start_s <= time < span.end_s for span in spans) for time in middle], bool)


def _select_contact(
    trajectory: GazeTrajectory, near: Float[ndarray, " T"], share: float, inside: Bool[ndarray, " K"]
) -> tuple[Bool[ndarray, " K"], float | None]:
    """Which fixations are at the listener, and where the last one would have to be cut to meet the share."""
    found = fixations(trajectory, np.stack([near, near], axis=-1))
    length = (found.end_s - found.start_s) * inside
    order = np.argsort(np.where(inside, found.location_rad[:, 0], np.inf), kind="stable")
    wanted = share * length.sum()
    before = np.cumsum(length[order]) - length[order]
    in_contact = np.zeros(len(length), bool)
    left = wanted - before
    in_contact[order] = (left >= length[order] / 2.0) & inside[order] & (left > 0)
    if share in (0.0, 1.0):
        in_contact = inside & (share == 1.0)
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
) -> GazeTrajectory:
    found = fixations(trajectory, offset)
    offsets = np.zeros_like(found.location_rad)
    aversion_end, away = -np.inf, np.zeros(2)
    for index, place in enumerate(found.location_rad):
        if not inside[index]:
            continue
        rng = np.random.default_rng([*seeds, int(found.start_s[index] * 1000)])
        far = float(np.hypot(*place))
        if in_contact[index] and far > NEAR_RAD:
            offsets[index] = (
                np.clip(0.4 * FACE_RADIUS_RAD * rng.standard_normal(2), -NEAR_RAD / 2, NEAR_RAD / 2) - place
            )
        elif not in_contact[index] and far < FAR_RAD:
            if found.start_s[index] > aversion_end or in_contact[index - 1]:
                away, aversion_end = _sample_aversion_rad(rng), found.start_s[index] + AVERSION_S
            offsets[index] = away  # what it looked at within the face is kept as a scan about the place
    return add_head_turns(shift_fixations(trajectory, offsets), found.start_s, offsets, HEAD_THRESHOLD_RAD, HEAD_GAIN)


def _sample_aversion_rad(rng: np.random.Generator) -> Float[ndarray, " 2"]:
    size = saccades.sample_amplitudes_rad(1, rng, MIN_AVERSION_DEG, MAX_AVERSION_DEG)
    step = saccades.sample_directions(1, rng, octant_probabilities("intimacy"))[0]
    return np.asarray(size * step / np.hypot(*step))
