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

from talkingeyes.animation import sight
from talkingeyes.animation.course import Course, fixations, reaimed, split, taken_along
from talkingeyes.audio.annotation import Span
from talkingeyes.physiology import saccades
from talkingeyes.synthesis.looking import FACE_RAD, octant_shares

# Gaze within this of the point between the listener's eyes is contact (as metrics.detectors.gaze_states has it).
CONTACT_RAD = float(np.radians(4.0))
# Fixations this near need not move to be contact, those this far need not move to be averted.
NEAR_RAD, FAR_RAD = float(np.radians(2.8)), float(np.radians(6.0))
LEAST_AVERSION_DEG, MOST_AVERSION_DEG = 7.0, 20.0
AVERSION_S = 2.0
MEMORY_S = 0.2
LEAST_PART_S = 0.3
HEAD_THRESHOLD_RAD, HEAD_GAIN = float(np.radians(5.0)), 0.4


def contacted(
    course: Course,
    listener_m: Float[ndarray, "T 3"],
    share: float,
    seeds: Sequence[int],
    spans: Sequence[Span] | None = None,
) -> Course:
    """The course with gaze at the listener for a share of the time, or of the spans that are given."""
    listener = sight.direction_rad(course.head, listener_m)
    beside = sight.from_between_rad(course.space_rad) - listener
    near = gaussian_filter1d(np.hypot(*beside.T), MEMORY_S * course.fps, mode="nearest")
    cuts = _cuts(course, spans)
    course = split(course, cuts)
    inside = _inside(course, spans)
    looking, cut = _chosen(course, near, share, inside)
    if cut is not None:
        course = split(course, [cut])
        inside = _inside(course, spans)
        looking, _ = _chosen(course, near, share, inside)
    return _moved(course, beside, looking, inside, seeds)


def share_of_contact(
    head: Float[ndarray, "T 3"], space_rad: Float[ndarray, "T 2 2"], listener_m: Float[ndarray, "T 3"]
) -> float:
    """The share of frames in which the line of sight is within `CONTACT_RAD` of the listener."""
    beside = sight.from_between_rad(space_rad) - sight.direction_rad(head, listener_m)
    return float((np.hypot(*beside.T) <= CONTACT_RAD).mean())


def _cuts(course: Course, spans: Sequence[Span] | None) -> list[float]:
    """Where spans begin and end inside a long enough fixation: gaze may change its place there."""
    found = fixations(course, course.together_rad)
    edges = [edge for span in spans or () for edge in (span.start_s, span.end_s)]
    cuts = []
    for edge in edges:
        index = int(np.searchsorted(found.start_s, edge, side="right")) - 1
        if index >= 0 and found.start_s[index] + LEAST_PART_S < edge < found.end_s[index] - LEAST_PART_S:
            cuts.append(edge)
    return cuts


def _inside(course: Course, spans: Sequence[Span] | None) -> Bool[ndarray, " K"]:
    """Whether each fixation is in a span."""
    found = fixations(course, course.together_rad)
    if spans is None:
        return np.ones(len(found.start_s), bool)
    middle = (found.start_s + found.end_s) / 2.0
    return np.array([any(span.start_s <= time < span.end_s for span in spans) for time in middle], bool)


def _chosen(
    course: Course, near: Float[ndarray, " T"], share: float, inside: Bool[ndarray, " K"]
) -> tuple[Bool[ndarray, " K"], float | None]:
    """Which fixations are at the listener, and where the last one would have to be cut to meet the share."""
    found = fixations(course, np.stack([near, near], axis=-1))
    length = (found.end_s - found.start_s) * inside
    order = np.argsort(np.where(inside, found.place_rad[:, 0], np.inf), kind="stable")
    wanted = share * length.sum()
    before = np.cumsum(length[order]) - length[order]
    looking = np.zeros(len(length), bool)
    left = wanted - before
    looking[order] = (left >= length[order] / 2.0) & inside[order] & (left > 0)
    if share in (0.0, 1.0):
        looking = inside & (share == 1.0)
        return looking, None
    last = order[np.clip(np.searchsorted(before, wanted, side="right") - 1, 0, len(order) - 1)]
    rest = wanted - before[order == last][0]
    fits = LEAST_PART_S <= rest <= length[last] - LEAST_PART_S
    return looking, float(found.start_s[last] + rest) if fits else None


def _moved(
    course: Course,
    beside: Float[ndarray, "T 2"],
    looking: Bool[ndarray, " K"],
    inside: Bool[ndarray, " K"],
    seeds: Sequence[int],
) -> Course:
    found = fixations(course, beside)
    offsets = np.zeros_like(found.place_rad)
    aversion_end, away = -np.inf, np.zeros(2)
    for index, place in enumerate(found.place_rad):
        if not inside[index]:
            continue
        random = np.random.default_rng([*seeds, int(found.start_s[index] * 1000)])
        far = float(np.hypot(*place))
        if looking[index] and far > NEAR_RAD:
            offsets[index] = np.clip(0.4 * FACE_RAD * random.standard_normal(2), -NEAR_RAD / 2, NEAR_RAD / 2) - place
        elif not looking[index] and far < FAR_RAD:
            if found.start_s[index] > aversion_end or looking[index - 1]:
                away, aversion_end = _away_rad(random), found.start_s[index] + AVERSION_S
            offsets[index] = away  # what it looked at within the face is kept as a scan about the place
    return taken_along(reaimed(course, offsets), found.start_s, offsets, HEAD_THRESHOLD_RAD, HEAD_GAIN)


def _away_rad(random: np.random.Generator) -> Float[ndarray, " 2"]:
    size = saccades.draw_amplitudes_rad(1, random, LEAST_AVERSION_DEG, MOST_AVERSION_DEG)
    step = saccades.draw_directions(1, random, octant_shares("intimacy"))[0]
    return np.asarray(size * step / np.hypot(*step))
