"""Steps of a conversation: nods, and gaze at the partner while listening.

Sources and distributions: `animation/listening_behaviour.py`. Eye contact set by the controls takes precedence.
"""

from __future__ import annotations

from dataclasses import replace

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.steps.eye_contact import EYE_CONTACT_STREAM, set_eye_contact
from talkingeyes.animation.steps.states import LISTENING_CONTACT
from talkingeyes.physiology import eye_head


def add_nods(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Add the nods that answer the partner's phrases."""
    if not context.listening:
        return trajectory
    nods = eye_head.head_path(context.listening.nods, trajectory.times_s)
    return replace(trajectory, head=trajectory.head + context.controls.liveliness.head * nods)


def look_at_partner(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Set the fraction of listening time with gaze at the partner."""
    if not (context.listening and context.turns) or context.controls.eye_contact is not None:
        return trajectory
    fraction = LISTENING_CONTACT if context.states else context.listening.gaze_fraction
    spans = context.turns.listening
    return set_eye_contact(trajectory, fraction, context, EYE_CONTACT_STREAM, spans)
