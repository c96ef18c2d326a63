"""Animate a dialogue: two sounds, or one with two channels; a motion for each speaker.

Each motion is sampled from the speaker's own speech, with the other's speech as the partner's
(`animation/listening_behaviour.py` says what is learnt and what is rule-based). The speakers face each other: each is
the other's listener, straight ahead unless a target track says otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.animation import Animation
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.controls import Controls

SECOND_SEED = 1


@dataclass(frozen=True)
class Dialogue:
    """The animations of both speakers of one conversation."""

    first: Animation
    second: Animation


def animate_dialogue(
    animator: Animator,
    sounds: Sequence[Float[ndarray, " _"]],
    samples: int,
    seed: int,
    fps: float,
    controls_by_speaker: tuple[Controls, Controls] = (Controls(), Controls()),
) -> list[Dialogue]:
    """Animate both speakers of two sounds (16 kHz) that start together; the shorter one is padded with silence."""
    frames = max(len(sound) for sound in sounds)
    one, other = (np.pad(sound, (0, frames - len(sound))) for sound in sounds)
    second_seed = int(np.random.SeedSequence([seed, SECOND_SEED]).generate_state(1)[0])
    first = animator.perform(one, samples, seed, fps, replace(controls_by_speaker[0], partner=other))
    second = animator.perform(other, samples, second_seed, fps, replace(controls_by_speaker[1], partner=one))
    return [Dialogue(*pair) for pair in zip(first, second, strict=True)]
