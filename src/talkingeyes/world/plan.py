"""Which sounds a synthetic corpus has, by whom, and the randomness that each is made from.

Every draw has a generator of its own, made from the corpus seed and what it is for, so a sound or a take is the same
whatever else the corpus holds, and however many processes make it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from talkingeyes.physiology.blinks import PROFILES, BlinkProfile
from talkingeyes.settings import Settings
from talkingeyes.world.noise import NoiseSettings
from talkingeyes.world.observations import CameraSettings
from talkingeyes.world.speakers import Speaker, draw_speaker
from talkingeyes.world.text import languages

STREAMS = {"speaker": 1, "sound": 2, "motion": 3, "noise": 4, "takes": 5}


class SynthesizeSettings(Settings):
    """The synthetic corpus: texts, voices, motion, noise."""

    seed: int = Field(ge=0)
    clips: int = Field(ge=10, le=10_000_000)  # sounds; further takes of a sound come on top
    speakers: int = Field(ge=4, le=100_000)  # 15 % of them are unseen
    shortest_s: float = Field(ge=8, le=60)  # a clip lasts between these; windows of 8 s are judged
    longest_s: float = Field(ge=8, le=60)
    takes: int = Field(ge=1, le=100)  # of each multi-take sound: same sound, motion drawn again
    multi_take_sounds: int = Field(ge=0)  # so many sounds of test, and so many of unseen
    fps: float = Field(ge=5, le=500)  # of motion and observations
    blinks: Literal["physio", "paper"]  # the profile of blinks
    languages: tuple[str, ...] = Field(min_length=1)  # speakers take turns in them
    camera: CameraSettings
    noise: NoiseSettings

    @model_validator(mode="after")
    def _fits(self) -> SynthesizeSettings:
        if self.longest_s < self.shortest_s + 0.5:
            raise ValueError(f"longest_s should be at least shortest_s + 0.5 ({self.shortest_s + 0.5})")
        if self.clips < self.speakers:
            raise ValueError(f"clips should be at least speakers ({self.speakers})")
        if unknown := set(self.languages) - set(languages()):
            raise ValueError(f"languages should be among {', '.join(languages())}, not {', '.join(sorted(unknown))}")
        return self

    @property
    def blink_profile(self) -> BlinkProfile:
        """The profile that `blinks` names."""
        return PROFILES[self.blinks]


@dataclass(frozen=True)
class Sound:
    """A sound of the plan: its number, its speaker's number, its id."""

    index: int
    speaker: int
    id: str


def generator(seed: int, stream: str, index: int, take: int = 0) -> np.random.Generator:
    """The generator of one draw; motion and sound have streams of their own."""
    return np.random.default_rng([seed, STREAMS[stream], index, take])


def sounds(settings: SynthesizeSettings) -> list[Sound]:
    """All sounds; speakers take turns."""
    numbers = [(index, index % settings.speakers) for index in range(settings.clips)]
    return [Sound(index, speaker, f"{speaker_name(speaker)}-{index:06d}") for index, speaker in numbers]


def speaker_name(number: int) -> str:
    """The id of a speaker."""
    return f"s{number:04d}"


def speaker_of(settings: SynthesizeSettings, sound: Sound) -> Speaker:
    """Who says it: the same person in all sounds of that speaker."""
    language = settings.languages[sound.speaker % len(settings.languages)]
    random = generator(settings.seed, "speaker", sound.speaker)
    return draw_speaker(speaker_name(sound.speaker), language, random, settings.blink_profile)
