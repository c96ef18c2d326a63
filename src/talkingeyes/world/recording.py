"""A sound of the corpus: what a voice makes of a script, amid silence, as long as a clip should be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Phoneme, Span
from talkingeyes.world.text import Script
from talkingeyes.world.voices import Spoken, Voice, speak

SAMPLE_RATE = 16_000
STEP = 640  # samples; 40 ms, so that 25 frames a second fit
LEAD_S, TRAIL_S = (0.10, 0.45), (0.25, 0.60)
HURRY = 1.03
TRIES = 3


@dataclass(frozen=True)
class Recording:
    """16 kHz sound of a whole number of 40 ms steps, and what is known about it in time."""

    sound: Float[ndarray, " N"]
    annotation: Annotation
    text: str

    @property
    def seconds(self) -> float:
        """How long it lasts."""
        return len(self.sound) / SAMPLE_RATE


def record(script: Script, voice: Voice, shortest_s: float, longest_s: float, random: np.random.Generator) -> Recording:
    """Speak a script with silence before and after it.

    A script too long for the clip is spoken faster, and cut only if that does not help; one too short ends in silence.
    """
    lead_s, trail_s = random.uniform(*LEAD_S), random.uniform(*TRAIL_S)
    room_s = longest_s - lead_s - trail_s
    spoken = speak(script, voice)
    for _ in range(TRIES):
        excess = len(spoken.sound) / SAMPLE_RATE / room_s
        if excess <= 1.0:
            break
        voice = replace(voice, rate_wpm=round(voice.rate_wpm * excess * HURRY))
        spoken = speak(script, voice)
    return _framed(spoken, lead_s, trail_s, shortest_s, longest_s)


def _framed(spoken: Spoken, lead_s: float, trail_s: float, shortest_s: float, longest_s: float) -> Recording:
    lead = round(lead_s * SAMPLE_RATE)
    wanted_s = np.clip(lead_s + len(spoken.sound) / SAMPLE_RATE + trail_s, shortest_s, longest_s)
    sound = np.zeros(STEP * int(np.ceil(round(wanted_s * SAMPLE_RATE) / STEP)), np.float32)
    sound[lead:][: len(spoken.sound)] = spoken.sound[: len(sound) - lead]
    annotation = moved(spoken.annotation, lead / SAMPLE_RATE, len(sound) / SAMPLE_RATE)
    return Recording(sound, annotation, spoken.text)


def moved(annotation: Annotation, by_s: float, seconds: float) -> Annotation:
    """The annotation later by `by_s`, without what lies beyond `seconds`."""
    return Annotation(
        words=_moved(annotation.words, by_s, seconds),
        phonemes=_moved(annotation.phonemes, by_s, seconds),
        speaking=_moved(annotation.speaking, by_s, seconds),
        listening=_moved(annotation.listening, by_s, seconds),
        pauses=_moved(annotation.pauses, by_s, seconds),
        fillers=_moved(annotation.fillers, by_s, seconds),
    )


Timed = TypeVar("Timed", Span, Phoneme)


def _moved(items: tuple[Timed, ...], by_s: float, seconds: float) -> tuple[Timed, ...]:
    kept = (item for item in items if item.start_s + by_s < seconds)
    return tuple(replace(item, start_s=item.start_s + by_s, end_s=min(item.end_s + by_s, seconds)) for item in kept)
