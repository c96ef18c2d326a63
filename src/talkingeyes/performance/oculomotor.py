"""What eyes and heads do that frames of fitted motion cannot teach: small saccades, and the head's part in large ones.

Video at 25 frames a second shows no saccade below a degree or so, and a few shifts in a hundred go far: a model that
learnt from it makes none of the first, and its head, which knows nothing of gaze, leaves the second to the eyes alone.
Both have their laws (physiology.saccades, physiology.eye_head), and so has how large a saccade in talk can be.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from talkingeyes import rotation
from talkingeyes.performance.course import LEAST_STEP_RAD, Course, fixations, reaimed, split, taken_along
from talkingeyes.physiology import saccades

LARGEST_RAD = float(np.radians(saccades.TALKING_CAP_DEG))
# Smaller ones a fit does not see; of Eyes Alive's saccades every eighth is.
SEEN_DEG = 1.2
UNSEEN = -np.expm1(-(SEEN_DEG - saccades.AMPLITUDE_MIN_DEG) / saccades.AMPLITUDE_MEAN_DEG)
LEAST_FIXATION_S = 0.2
# The middle of what people's heads do (Stahl 1999: from 5 to 20 degrees on, .3 to .9 of what is beyond).
HEAD_THRESHOLD_RAD, HEAD_GAIN = float(np.radians(12.5)), 0.6
GLANCE_S = 0.5  # before the head is there, the eyes are back


def capped(course: Course) -> Course:
    """The course with no saccade larger than talk has them (Lee, Badler & Badler 2002): one that is falls short, and
    a second one makes up for it, unless the next is there before."""
    over = np.hypot(*course.steps_rad.T) > LARGEST_RAD
    if not over.any():
        return course
    onset_s = np.array([each.onset_s for each in course.saccades])
    second_s = onset_s + LEAST_FIXATION_S
    in_time = second_s + LEAST_FIXATION_S < np.append(onset_s[1:], course.seconds)
    course = split(course, second_s[over & in_time].tolist())
    offsets = np.zeros((len(course.saccades) + 1, 2))
    for index, planned in enumerate(course.steps_rad):
        step = planned - offsets[index]
        offsets[index + 1] = step * min(1.0, LARGEST_RAD / max(float(np.hypot(*step)), LEAST_STEP_RAD)) - step
    return reaimed(course, offsets)


def accompanied(course: Course) -> Course:
    """The course with the head taken along where gaze is far off to a side of it, but for glances."""
    pointing = rotation.angles_of_direction(rotation.directions(course.head))
    found = fixations(course, course.together_rad - pointing)
    long = found.end_s - found.start_s >= GLANCE_S
    return taken_along(course, found.start_s[long], found.place_rad[long], HEAD_THRESHOLD_RAD, HEAD_GAIN)


def scanned(course: Course, seeds: Sequence[int]) -> Course:
    """The course with the saccades within fixations that are too small to be seen in video, in the numbers, sizes and
    directions of Eyes Alive's law; the next one that is seen goes where it went."""
    random = np.random.default_rng(seeds)
    found = fixations(course, course.together_rad)
    first_s, last_s = found.start_s + LEAST_FIXATION_S, found.end_s - LEAST_FIXATION_S
    room_s = np.maximum(last_s - first_s, 0.0)
    count = random.poisson(len(course.saccades) * UNSEEN / (1.0 - UNSEEN))
    if not count or not room_s.any():
        return course
    within = random.choice(len(room_s), count, p=room_s / room_s.sum())
    onsets = np.sort(first_s[within] + random.random(count) * room_s[within])
    onsets = onsets[np.diff(onsets, prepend=-np.inf) >= LEAST_FIXATION_S]
    new = split(course, onsets.tolist())
    sizes = saccades.draw_amplitudes_rad(len(onsets), random, saccades.AMPLITUDE_MIN_DEG, SEEN_DEG)
    offsets = np.zeros((len(new.saccades) + 1, 2))
    small = np.isin([each.onset_s for each in new.saccades], onsets)
    offsets[1:][small] = sizes[:, None] * saccades.draw_directions(len(onsets), random)
    return reaimed(new, offsets)
