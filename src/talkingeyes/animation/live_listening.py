"""Gaze of a stream while the partner speaks: at the partner and away for as long as recorded people look.

A live model hears its own channel alone, and to it the partner's turn is a pause. Who has the turn is found while both
sounds come: the partner keeps it for a second after speaking, unless the subject speaks, as in files
(`audio/turn_taking.py`). Looks are sampled from the same function as in files (`listening_behaviour.py`).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.listening_behaviour import HABIT_STREAM, ListeningLooks
from talkingeyes.animation.live_nods import MIN_SPEECH_STEPS, PhraseDetector
from talkingeyes.audio.turn_taking import TURN_S
from talkingeyes.audio.voice_activity import STEP_S


class LiveListening:
    """Whether one person listens, and looks at the partner; sound is known up to `known_s` after each frame."""

    def __init__(self, fps: float, known_s: float, population: str, seeds: list[int]) -> None:
        self._fps, self._known_s = fps, known_s
        self._looks = ListeningLooks(population, [*seeds, HABIT_STREAM], np.random.default_rng(seeds))
        self._voices = PhraseDetector(), PhraseDetector()  # the subject, the partner
        self._listens = bytearray()  # by step
        self._averted, self._until_s, self._frame = False, -np.inf, 0

    def push(self, own: Float[ndarray, " N"], partner: Float[ndarray, " N"]) -> None:
        """Take the next samples of both (16 kHz), before the frames that are given with them."""
        self._voices[0].push(own)
        self._voices[1].push(partner)
        for (_, subject_last), (first, last) in zip(*(voice.active_steps for voice in self._voices), strict=True):
            begun, held = last - first + 1 >= MIN_SPEECH_STEPS, (len(self._listens) + 1 - last) * STEP_S <= TURN_S
            self._listens.append(begun and held and last > subject_last)

    def contact(self, frames: int) -> list[float | None]:
        """The share of eye contact in each of the next frames: 1 or 0 while listening, None else."""
        found = [self._contact(frame) for frame in range(self._frame, self._frame + frames)]
        self._frame += frames
        return found

    def _contact(self, frame: int) -> float | None:
        time_s = frame / self._fps
        step = min(int((time_s + self._known_s) / STEP_S), len(self._listens)) - 1
        if step < 0 or not self._listens[step]:
            self._until_s = -np.inf
            return None
        if self._until_s == -np.inf:
            self._averted = self._looks.first_averted()
            self._until_s = time_s + self._looks.dwell_s(self._averted)
        while time_s >= self._until_s:
            self._averted = not self._averted
            self._until_s += self._looks.dwell_s(self._averted)
        return 0.0 if self._averted else 1.0
