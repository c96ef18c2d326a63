"""The reason of each gaze shift, by where it goes and what happens in the conversation at that time.

The learnt model states no cause, so reasons are assigned afterwards by rule. A shift to the partner is a `return`, one
that stays at the partner, or away, a `scan`. One that leaves the partner has the first of these reasons that holds:

    target       a target track aims gaze
    control      the fraction of eye contact was set
    thinking     the state
    idle         the state
    turn start   from 1.3 s before to 1 s after the first word of a turn (Kendon 1967; Andrist et al. 2013)
    hesitation   in a pause within the own turn (Kendon 1967)
    planning     up to 1.3 s before the end of such a pause, or in the first second after it (Andrist et al. 2013)
    intimacy     else: it regulates how much the two look at each other (Argyle & Dean 1965; Andrist et al. 2013)
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.conversation_states import IDLE_S, THINKING_S, states_of_turns
from talkingeyes.animation.event_keys import ShiftReason
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.steps.eye_contact import CONTACT_RAD
from talkingeyes.audio.annotation import Annotation, Span

REASONS = (
    "return",
    "scan",
    "target",
    "control",
    "thinking",
    "idle",
    "turn start",
    "hesitation",
    "planning",
    "intimacy",
)
BEFORE_ONSET_S, AFTER_ONSET_S = 1.3, 1.0
MIN_PAUSE_S = 0.25


def shift_reasons(trajectory: GazeTrajectory, context: AnimationContext) -> tuple[ShiftReason, ...]:
    """The reason of each saccade of a trajectory; none if the sound is not known."""
    if context.turns is None or not trajectory.saccades:
        return ()
    states = context.states or states_of_turns(context.turns, trajectory.seconds)
    onsets_s = np.array([each.onset_s for each in trajectory.saccades])
    ends_s = np.array([each.onset_s + each.duration_s for each in trajectory.saccades])
    at_listener = _at_listener(trajectory, context)
    before, after = (
        at_listener[np.clip(frames.astype(int), 0, len(at_listener) - 1)].tolist()
        for frames in (np.floor(onsets_s * trajectory.fps), np.ceil(ends_s * trajectory.fps))
    )
    found = []
    for onset_s, was_near, is_near in zip(onsets_s.tolist(), before, after, strict=True):
        state = next((span.label for span in states if span.start_s <= onset_s < span.end_s), states[-1].label)
        reason = "scan" if was_near == is_near else "return"
        if was_near and not is_near:
            reason = _reason_to_leave(onset_s, state, context, context.turns)
        found.append(ShiftReason(onset_s, state, reason))
    return tuple(found)


def _at_listener(trajectory: GazeTrajectory, context: AnimationContext) -> Bool[ndarray, " T"]:
    """Whether the line of sight is at the listener."""
    listener = line_of_sight.target_direction_rad(trajectory.head, context.listener(trajectory.times_s))
    away = np.hypot(*(line_of_sight.cyclopean_line_of_sight_rad(trajectory.gaze_in_space_rad) - listener).T)
    return np.asarray(away <= CONTACT_RAD)


def _reason_to_leave(onset_s: float, state: str, context: AnimationContext, turns: Annotation) -> str:
    targets = context.controls.targets.targets if context.controls.targets else ()
    if any(target.start_s <= onset_s < target.end_s for target in targets):
        return "target"
    if context.controls.eye_contact is not None:
        return "control"
    return state if state in ("thinking", "idle") else _reason_in_speech(onset_s, turns)


def _reason_in_speech(onset_s: float, turns: Annotation) -> str:
    if any(start - BEFORE_ONSET_S <= onset_s < start + AFTER_ONSET_S for start in turn_starts_s(turns)):
        return "turn start"
    pauses = own_pauses(turns)
    if any(pause.start_s <= onset_s < pause.end_s for pause in pauses):
        return "hesitation"
    planned_s = [pause.end_s for pause in pauses if pause.end_s - pause.start_s >= THINKING_S]
    planning = any(end - BEFORE_ONSET_S <= onset_s < end + AFTER_ONSET_S for end in planned_s)
    return "planning" if planning else "intimacy"


def turn_starts_s(turns: Annotation) -> list[float]:
    """First words of the own turns: after the partner has spoken, or after a long silence."""
    starts = [span.start_s for span in turns.speaking[:1]]
    for before, span in pairwise(turns.speaking):
        answered = any(before.end_s <= each.end_s <= span.start_s for each in turns.partner)
        if answered or span.start_s - before.end_s >= IDLE_S:
            starts.append(span.start_s)
    return starts


def own_pauses(turns: Annotation) -> list[Span]:
    """Pauses within the own turns."""
    pauses = [Span(one.end_s, following.start_s) for one, following in pairwise(turns.speaking)]
    return [pause for pause in pauses if MIN_PAUSE_S <= pause.end_s - pause.start_s < IDLE_S]
