"""Nods of a stream: the ends of the partner's phrases, found while the sound comes, and the nods that answer them.

Files find phrases in the whole sound (`audio/voice_activity.py`) and sample nods 0.1 to 0.5 s after some of their
ends (`synthesis/head_gestures.py: listener_nods`), unless the person nods already. A stream samples from the same
function. An end is known 0.26 s later, as a phrase may have gaps of 0.25 s. A stream has the sound up to 0.237 s after
the frame that it gives, so an end is known before its earliest nod; a model with less lookahead nods once it is known.

Levels are compared with those of the last 30 s. Unlike in files, a sound of nearly constant level is no speech: it is
more often the noise of a microphone than speech without a pause.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.streaming_prosody import BLOCK_SAMPLES, RunningLevel
from talkingeyes.audio.voice_activity import (
    ABOVE_QUIET_DB,
    BELOW_LOUD_DB,
    FLOOR_DBFS,
    MIN_GAP_S,
    MIN_SPEECH_S,
    STEP_S,
    WINDOW_S,
)
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.motion import HeadMovement
from talkingeyes.physiology import eye_head
from talkingeyes.synthesis import head_gestures
from talkingeyes.synthesis.speakers import sample_style

STEP_SAMPLES, WINDOW_STEPS = round(STEP_S * SAMPLE_RATE), round(WINDOW_S / STEP_S)
MIN_GAP_STEPS, MIN_SPEECH_STEPS = round(MIN_GAP_S / STEP_S), round(MIN_SPEECH_S / STEP_S)
MEMORY_STEPS = 3000  # 30 s
QUIET_SHARE = 0.05  # as the percentile of quiet parts in files


@dataclass(frozen=True)
class Phrase:
    """A phrase of the partner, and when it was known to be over."""

    span: Span
    known_s: float


class PhraseDetector:
    """Finds phrases in one sound, chunk by chunk; the result does not depend on the chunks."""

    def __init__(self) -> None:
        self._rest, self._loud = np.zeros(0, np.float32), RunningLevel()
        self._power: deque[float] = deque(maxlen=WINDOW_STEPS)
        self._levels: deque[float] = deque()
        self._sorted: list[float] = []  # the same levels
        self._step, self._active_steps = 0, [0, -MEMORY_STEPS]  # steps so far; first and last one of the phrase
        self.active_steps: list[tuple[int, int]] = []  # after each step of the last chunk

    def push(self, chunk: Float[ndarray, " N"]) -> list[Phrase]:
        """Take 16 kHz samples, and return the phrases that are known to be over now."""
        self._loud.push(chunk)
        self.active_steps = []
        sound = np.concatenate([self._rest, chunk])
        whole = len(sound) // STEP_SAMPLES * STEP_SAMPLES
        self._rest = sound[whole:]
        powers = np.square(sound[:whole].reshape(-1, STEP_SAMPLES), dtype=np.float64).mean(axis=1)
        return [phrase for power in powers.tolist() if (phrase := self._add_step(power))]

    def _add_step(self, power: float) -> Phrase | None:
        self._power.append(power)
        level = max(10.0 * float(np.log10(max(sum(self._power) / len(self._power), 1e-20))), FLOOR_DBFS)
        self._remember(level)
        self._step += 1
        loud = self._loud.levels_dbfs[self._step * STEP_SAMPLES // BLOCK_SAMPLES]
        quiet = self._sorted[int(QUIET_SHARE * len(self._sorted))]
        first, last = self._active_steps
        if level > max(loud - BELOW_LOUD_DB, quiet + ABOVE_QUIET_DB):
            self._active_steps = [first if self._step - last <= MIN_GAP_STEPS else self._step, self._step]
        self.active_steps.append((self._active_steps[0], self._active_steps[1]))
        if (
            self._step - last == MIN_GAP_STEPS
            and last - first + 1 >= MIN_SPEECH_STEPS
            and last == self._active_steps[1]
        ):
            # The level of a step is that of a window which ends with it.
            start_s, end_s = ((step - WINDOW_STEPS / 2) * STEP_S for step in (first, last + 1))
            return Phrase(Span(start_s, end_s), self._step * STEP_S)
        return None

    def _remember(self, level: float) -> None:
        self._levels.append(level)
        insort(self._sorted, level)
        if len(self._levels) > MEMORY_STEPS:
            del self._sorted[bisect_left(self._sorted, self._levels.popleft())]


class LiveNods:
    """The nods of one stream, whose frames are given `latency_s` after their time."""

    def __init__(self, latency_s: float, seeds: list[int]) -> None:
        self._latency_s, self._rng = latency_s, np.random.default_rng(seeds)
        self._style = sample_style(self._rng)
        self._phrases, self._end_s = PhraseDetector(), -np.inf  # of the last nods
        self._sampled: list[list[HeadMovement]] = []  # not begun
        self._begun: list[list[HeadMovement]] = []

    def push(self, partner: Float[ndarray, " N"]) -> None:
        """Take the next samples of the partner (16 kHz), before the frames that are given with them."""
        for phrase in self._phrases.push(partner):
            turns = Annotation(partner=(phrase.span,))
            moves = head_gestures.listener_nods(turns, self._style, self._rng)
            if moves and moves[0].onset_s >= self._end_s:
                self._end_s = moves[-1].onset_s + moves[-1].duration_s
                late_s = max(0.0, phrase.known_s - self._latency_s - moves[0].onset_s)
                self._sampled.append([replace(move, onset_s=move.onset_s + late_s) for move in moves])

    def rotation(self, times_s: Float[ndarray, " T"], is_listening: bool) -> Float[ndarray, "T 3"]:
        """What nods add to the head in the next frames; they begin only while `is_listening`."""
        begun = [moves for moves in self._sampled if moves[0].onset_s < times_s[-1]]
        self._sampled = [moves for moves in self._sampled if moves[0].onset_s >= times_s[-1]]
        self._begun += begun if is_listening else []
        self._begun = [each for each in self._begun if each[-1].onset_s + each[-1].duration_s > times_s[0]]
        return sum((eye_head.head_path(moves, times_s) for moves in self._begun), np.zeros((len(times_s), 3)))
