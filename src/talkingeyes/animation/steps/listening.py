"""Steps of a conversation: nods, and gaze at the partner while listening.

Sources and distributions: `animation/listening_behaviour.py`. Eye contact set by the controls takes precedence.
"""

from __future__ import annotations

from dataclasses import replace

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.steps.eye_contact import EYE_CONTACT_STREAM, set_eye_contact
from talkingeyes.animation.steps.states import LISTENING_CONTACT
from talkingeyes.audio.annotation import Span
from talkingeyes.physiology import eye_head


def add_nods(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Add the nods that answer the partner's phrases."""
    if not context.listening:
        return trajectory
    nods = eye_head.head_path(context.listening.nods, trajectory.times_s)
    return replace(trajectory, head=trajectory.head + context.controls.liveliness.head * nods)


def look_at_partner(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Look at the partner and away while listening; with states, a share of the time."""
    if not (context.listening and context.turns) or context.controls.eye_contact is not None:
        return trajectory
    if context.states:
        return set_eye_contact(trajectory, LISTENING_CONTACT, context, EYE_CONTACT_STREAM, context.turns.listening)
    for fraction in (0.0, 1.0):
        spans = [Span(look.start_s, look.end_s) for look in context.listening.looks if look.averted != bool(fraction)]
        trajectory = set_eye_contact(trajectory, fraction, context, EYE_CONTACT_STREAM, spans)
    return trajectory
