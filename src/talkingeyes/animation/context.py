"""What the animation steps read besides the trajectory: the controls, and what was derived from them and the sound."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.controls import Controls
from talkingeyes.animation.listening_behaviour import ListeningBehaviour, sample_listening_behaviour
from talkingeyes.animation.targets import LISTENER, TargetTrack
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.fitting.motion_style import MotionStyle
from talkingeyes.physiology.blinks import PHYSIOLOGICAL, BlinkProfile

LISTENING_STREAM = 3


@dataclass(frozen=True)
class MotionCentre:
    """Mean head pose (rotation vector) and mean direction of gaze (yaw, pitch) about which liveliness scales."""

    head: Float[ndarray, " 3"]
    gaze_rad: Float[ndarray, " 2"]


@dataclass(frozen=True)
class AnimationContext:
    """The context of one sample.

    `turns` is who speaks when, if the sound is known. `states` cover the whole time, if the controls ask for them
    (`conversation_states.py`). `listening` is set in a conversation, where the controls name the partner's sound or
    states. `blink_rate_rank` is the fraction of training speakers who blink less often than this person.
    `centre` is None where it is computed from the whole trajectory, which a stream does not have.
    """

    controls: Controls
    seeds: tuple[int, ...] = (0, 0)
    blink_profile: BlinkProfile = PHYSIOLOGICAL
    motion_style: MotionStyle | None = None
    blink_rate_rank: float | None = None
    turns: Annotation | None = None
    states: tuple[Span, ...] = ()
    listening: ListeningBehaviour | None = None
    centre: MotionCentre | None = None

    def for_sample(self, index: int) -> AnimationContext:
        """The context of sample `index`: its seeds, and its listening behaviour in a conversation."""
        context = replace(self, seeds=(*self.seeds[:1], index))
        if (self.controls.partner is None and not self.states) or self.turns is None:
            return context
        seeds = context.stream(LISTENING_STREAM)
        person = self.controls.person
        habits = None if person is None else [*person.encode(), LISTENING_STREAM]
        listening = sample_listening_behaviour(self.turns, seeds, self.controls.population, habits)
        return replace(context, listening=listening)

    def stream(self, number: int) -> list[int]:
        """Seeds of an independent random stream of this sample; each step has a number of its own."""
        return [*self.seeds, number]

    def listener(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 4"]:
        """Homogeneous position of the listener at each time: straight ahead, unless the target track moves it."""
        return (self.controls.targets or TargetTrack()).object_track(LISTENER).at(times_s)


def sample_seeds(seed: int, samples: int) -> list[int]:
    """One seed per sample for the generators of head and gaze; sample i has the same seed however many there are."""
    return [int(np.random.SeedSequence([seed, index]).generate_state(1)[0]) for index in range(samples)]
