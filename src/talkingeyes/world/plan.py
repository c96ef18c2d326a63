"""Which sounds a synthetic corpus has, by whom, and the randomness that each is made from.

Every draw has a generator of its own, made from the corpus seed and what it is for, so a sound or a take is the same
whatever else the corpus holds, and however many processes make it. Splits are dealt before anything is said; each has
a share of all text to itself, so no sentence occurs in two of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from talkingeyes.audio.annotation import EMOTIONS, INTENSITIES
from talkingeyes.corpus.index import SPLITS
from talkingeyes.corpus.splits import split_sounds
from talkingeyes.errors import InputError
from talkingeyes.physiology.blinks import PROFILES, BlinkProfile
from talkingeyes.settings import Settings, out_of_bounds
from talkingeyes.world.accents import ACCENTS, VOICE_NAMES, draw_voice, in_mood, is_voice
from talkingeyes.world.acoustics import AcousticsSettings
from talkingeyes.world.noise import NoiseSettings
from talkingeyes.world.observations import CameraSettings
from talkingeyes.world.speakers import Speaker, draw_speaker
from talkingeyes.world.text import TextShare, languages
from talkingeyes.world.voices import Cast

STREAMS = {"speaker": 1, "sound": 2, "motion": 3, "noise": 4, "takes": 5, "scene": 6, "partner": 7, "acoustics": 8}
NARROWEST_S = 0.5
TEXT = {
    "train": TextShare(0.0, 0.64),
    "val": TextShare(0.64, 0.76),
    "test": TextShare(0.76, 0.88),
    "unseen": TextShare(0.88, 1.0),
}


class SourceSettings(Settings):
    """People who are alike in how they were recorded: how many, how long, how lively."""

    clips: int = Field(ge=1, le=10_000_000)  # sounds; further takes of a sound come on top
    speakers: int = Field(ge=1, le=100_000)
    shortest_s: float = Field(ge=4, le=600)  # a clip lasts between these (log-uniform)
    longest_s: float = Field(ge=4, le=600)
    listening_share: float = Field(ge=0, le=1)  # of the sounds have a partner who speaks by turns
    liveliness: float = Field(gt=0, le=3)  # of gaze: how often and how far it leaves its place

    @model_validator(mode="after")
    def _source_fits(self) -> SourceSettings:
        least_s = self.shortest_s + NARROWEST_S
        if self.longest_s < least_s:
            raise out_of_bounds(f"longest_s should be at least shortest_s + {NARROWEST_S} ({least_s})", self.longest_s)
        if self.clips < self.speakers:
            raise out_of_bounds(f"clips should be at least speakers ({self.speakers})", self.clips)
        return self


class SynthesizeSettings(SourceSettings):
    """The synthetic corpus: texts, voices, motion, noise. Its own keys are those of its first source."""

    seed: int = Field(ge=0)
    clips: int = Field(ge=10, le=10_000_000)
    speakers: int = Field(ge=4, le=100_000)  # 15 % of all are unseen
    source: str = Field(pattern=r"^\w+$")
    further_sources: dict[str, SourceSettings]
    takes: int = Field(ge=1, le=100)  # of each multi-take sound: same sound, motion drawn again
    multi_take_sounds: int = Field(ge=0)  # so many sounds of test, and so many of unseen
    fps: float = Field(ge=5, le=500)  # of motion and observations
    blinks: Literal["physio", "paper"]  # the profile of blinks
    languages: tuple[str, ...] = Field(min_length=1)  # speakers take turns in them
    voices: tuple[str, ...]  # of espeak-ng, such as en-us+f3; none: all of these languages
    neutral_share: float = Field(ge=0, le=1)  # of the sounds; the others are in one of seven emotions
    acoustics: AcousticsSettings
    camera: CameraSettings
    noise: NoiseSettings

    @model_validator(mode="after")
    def _fits(self) -> SynthesizeSettings:
        if self.source in self.further_sources:
            raise out_of_bounds(f"further_sources should have other names than {self.source}", self.source)
        if unknown := set(self.languages) - set(languages()):
            raise out_of_bounds(f"languages should be among {', '.join(languages())}", ", ".join(sorted(unknown)))
        for voice in self.voices:
            if not is_voice(voice):
                raise out_of_bounds(f"voices should be {VOICE_NAMES}", voice)
        for language in self.languages if self.voices else ():
            if not any(voice.partition("+")[0] in ACCENTS[language] for voice in self.voices):
                raise out_of_bounds(
                    f"voices should have one for {language} ({', '.join(ACCENTS[language])})", ", ".join(self.voices)
                )
        return self

    @property
    def blink_profile(self) -> BlinkProfile:
        """The profile that `blinks` names."""
        return PROFILES[self.blinks]

    @property
    def sources(self) -> Mapping[str, SourceSettings]:
        """All sources by name."""
        return {self.source: self, **self.further_sources}


@dataclass(frozen=True)
class Sound:
    """A sound of the plan: who says it in which mood, whether a partner speaks too, where it belongs."""

    index: int
    speaker: int
    id: str
    source: str
    split: str
    takes: int
    emotion: str
    intensity: int
    listening: bool


def generator(seed: int, stream: str, index: int, take: int = 0) -> np.random.Generator:
    """The generator of one draw; motion and sound have streams of their own."""
    return np.random.default_rng([seed, STREAMS[stream], index, take])


def sounds(settings: SynthesizeSettings) -> list[Sound]:
    """All sounds, source by source; speakers take turns. Raises InputError when a split stays empty."""
    placed = _placed(settings)
    speaker_of = {sound_id: speaker_name(speaker) for sound_id, speaker, _ in placed}
    split = split_sounds(speaker_of, dict.fromkeys(speaker_of, ()), settings.seed)
    several = _with_takes(split, settings)
    found = []
    for index, (sound_id, speaker, source) in enumerate(placed):
        random = generator(settings.seed, "scene", index)
        listening = bool(random.random() < settings.sources[source].listening_share)
        emotion, intensity = "neutral", 0
        if random.random() >= settings.neutral_share:
            emotion, intensity = EMOTIONS[random.integers(1, len(EMOTIONS))], INTENSITIES[random.integers(3)]
        takes = settings.takes if sound_id in several else 1
        found.append(Sound(index, speaker, sound_id, source, split[sound_id], takes, emotion, intensity, listening))
    return found


def _placed(settings: SynthesizeSettings) -> list[tuple[str, int, str]]:
    found: list[tuple[str, int, str]] = []
    first_speaker = 0
    for source, each in settings.sources.items():
        for number in range(each.clips):
            speaker = first_speaker + number % each.speakers
            found.append((f"{speaker_name(speaker)}-{len(found):06d}", speaker, source))
        first_speaker += each.speakers
    return found


def _with_takes(split: Mapping[str, str], settings: SynthesizeSettings) -> set[str]:
    chosen: set[str] = set()
    for name in SPLITS:
        members = sorted(sound for sound, where in split.items() if where == name)
        if not members:
            raise InputError(
                f"synthesize.clips: should be enough for every split ({name} has none), got {settings.clips}"
            )
        if name in ("test", "unseen"):
            random = generator(settings.seed, "takes", SPLITS.index(name))
            count = min(settings.multi_take_sounds, len(members))
            chosen.update(str(sound) for sound in random.choice(members, count, replace=False))
    return chosen


def speaker_name(number: int) -> str:
    """The id of a speaker."""
    return f"s{number:04d}"


def speaker_of(settings: SynthesizeSettings, sound: Sound) -> Speaker:
    """Who says it: the same person in all sounds of that speaker."""
    random = generator(settings.seed, "speaker", sound.speaker)
    return draw_speaker(
        speaker_name(sound.speaker),
        _language(settings, sound),
        random,
        settings.blink_profile,
        settings.sources[sound.source].liveliness,
        settings.voices,
    )


def cast_of(settings: SynthesizeSettings, sound: Sound) -> Cast:
    """Whose voices are heard: the speaker's in the mood of the sound, and a partner's, drawn for this sound."""
    voice = in_mood(speaker_of(settings, sound).voice, sound.emotion, sound.intensity)
    if not sound.listening:
        return Cast(voice)
    random = generator(settings.seed, "partner", sound.index)
    return Cast(voice, draw_voice(random, _language(settings, sound), settings.voices))


def _language(settings: SynthesizeSettings, sound: Sound) -> str:
    return settings.languages[sound.speaker % len(settings.languages)]
