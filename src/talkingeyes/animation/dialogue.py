"""Two people talk with each other: a sound for each, or one with two channels; a motion for each of them.

Each motion is made from the own speech by the model, with the other's speech as the partner's (`listening` says what is
learnt and what is a rule). The two sit face to face: each is the other's listener, straight ahead unless a track of
targets says otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.animator import Animation, Animator
from talkingeyes.animation.controls import Controls

SECOND_SEED = 1


@dataclass(frozen=True)
class Dialogue:
    """One conversation: what each of the two does, at the same times."""

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
    """`samples` dialogues of two sounds (16 kHz) that begin together; the shorter one is silent in the end."""
    frames = max(len(sound) for sound in sounds)
    one, other = (np.pad(sound, (0, frames - len(sound))) for sound in sounds)
    second_seed = int(np.random.SeedSequence([seed, SECOND_SEED]).generate_state(1)[0])
    first = animator.perform(one, samples, seed, fps, replace(controls_by_speaker[0], partner=other))
    second = animator.perform(other, samples, second_seed, fps, replace(controls_by_speaker[1], partner=one))
    return [Dialogue(*pair) for pair in zip(first, second, strict=True)]
