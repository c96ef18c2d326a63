"""Steps of the states of a conversation: where gaze is, and how much the head moves, while not speaking.

Speaking is the model's. The other states are rules:

    listening   gaze at the partner for 95 % of the time (Lee, Badler & Badler 2002: 95 %; recorded people,
                docs/results/people.md: 91 %); nods are those of a conversation (`steps/listening.py`)
    thinking    gaze averted for 80 % (Kendon 1967: 20 % looking in hesitant speech), in directions of cognitive
                aversion (Andrist et al. 2013: up 39 %, to the side 32 %); the head moves half as much
    idle        gaze at the partner for 60 % (Argyle & Ingham 1972: 61 % of a conversation; no figure of waiting people
                is known)

A fixation in these states that lasts long gets small scanning saccades, so that no state freezes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.conversation_states import State, spans_of
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, fixations, shift_fixations, split_fixations
from talkingeyes.animation.steps.eye_contact import set_eye_contact
from talkingeyes.synthesis.gaze_aversion import AversionCause
from talkingeyes.synthesis.gaze_shifts import SCAN_MEDIAN_S, SCAN_SPREAD

LISTENING_CONTACT = 0.95
# Contact, cause of aversions, and stream of random numbers.
AVERTING: dict[State, tuple[float, AversionCause, int]] = {
    "thinking": (0.2, "planning", 6),
    "idle": (0.6, "intimacy", 7),
}
# Values without a source are choices of this project.
SCAN_STREAM = 8
THINKING_HEAD, HEAD_SMOOTHING_S = 0.5, 0.3
LONG_FIXATION_S, MIN_SCAN_S, SCAN_RAD = 1.2, 0.25, float(np.radians(1.2))


def calm_head(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Scale the head about its mean pose while thinking; gaze in space stays."""
    spans = spans_of(context.states, "thinking")
    if not spans:
        return trajectory
    times_s = trajectory.times_s
    inside = np.zeros(len(times_s))
    for span in spans:
        inside[(times_s >= span.start_s) & (times_s < span.end_s)] = 1.0
    gain = 1.0 + (THINKING_HEAD - 1.0) * gaussian_filter1d(inside, HEAD_SMOOTHING_S * trajectory.fps, mode="nearest")
    centre = trajectory.head.mean(axis=0)
    return replace(trajectory, head=centre + gain[:, None] * (trajectory.head - centre))


def look_by_state(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Set the fraction of time with gaze at the partner while thinking and idle, and scan in long fixations."""
    if not context.states:
        return trajectory
    if context.controls.eye_contact is None:
        for state, (fraction, cause, stream) in AVERTING.items():
            if spans := spans_of(context.states, state):
                trajectory = set_eye_contact(trajectory, fraction, context, stream, spans, cause)
    return scan_long_fixations(trajectory, context)


def scan_long_fixations(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Add small saccades to fixations longer than LONG_FIXATION_S, except while speaking."""
    gain = context.controls.liveliness.gaze
    quiet = [span for span in context.states if span.label != "speaking"]
    if not gain:
        return trajectory
    rng = np.random.default_rng(context.stream(SCAN_STREAM))
    found = fixations(trajectory, trajectory.cyclopean_rad)
    onsets: list[float] = []
    for start, end in zip(found.start_s, found.end_s, strict=True):
        if end - start < LONG_FIXATION_S:
            continue
        time_s = start
        while (time_s := time_s + max(MIN_SCAN_S, SCAN_MEDIAN_S * rng.lognormal(0.0, SCAN_SPREAD))) < end - MIN_SCAN_S:
            if any(span.start_s <= time_s < span.end_s for span in quiet):
                onsets.append(float(time_s))
    if not onsets:
        return trajectory
    new = split_fixations(trajectory, onsets)
    added = np.isin([each.onset_s for each in new.saccades], onsets)
    offsets = np.zeros((len(new.saccades) + 1, 2))
    offsets[1:][added] = gain * sample_scans_rad(rng, len(onsets))
    return shift_fixations(new, offsets)


def sample_scans_rad(rng: np.random.Generator, count: int) -> Float[ndarray, "K 2"]:
    """Sample where scanning saccades go, from the fixation."""
    return np.asarray(np.clip(0.5 * SCAN_RAD * rng.standard_normal((count, 2)), -SCAN_RAD, SCAN_RAD))
