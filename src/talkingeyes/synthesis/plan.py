"""Plan of a synthetic corpus: its sounds, speakers and random generators.

Each sampling step has its own random generator, seeded with the corpus seed and the purpose. A sound or take therefore
does not depend on the rest of the corpus, nor on the number of processes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from talkingeyes.audio.annotation import EMOTIONS, INTENSITIES
from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.physiology.blinks import PROFILES, BlinkProfile
from talkingeyes.synthesis.acoustics import AcousticsSettings
from talkingeyes.synthesis.detector_noise import NoiseSettings
from talkingeyes.synthesis.individuality import individualise_style
from talkingeyes.synthesis.observations import CameraSettings
from talkingeyes.synthesis.speakers import Speaker, sample_speaker, with_habits
from talkingeyes.synthesis.speech_synthesis import DialogueVoices
from talkingeyes.synthesis.text import languages
from talkingeyes.synthesis.voice_profiles import ACCENTS, VOICE_NAMES, apply_emotion, is_voice, sample_voice

STREAMS = {"speaker": 1, "sound": 2, "motion": 3, "noise": 4, "takes": 5, "scene": 6, "partner": 7, "acoustics": 8}
STREAMS |= {"individual": 9, "habits": 10}
MIN_LENGTH_RANGE_S = 0.5


class SourceSettings(Settings):
    """A group of speakers recorded under the same conditions: number, durations, liveliness."""

    clips: int = Field(ge=1, le=10_000_000)  # sounds; further takes of a sound are additional
    speakers: int = Field(ge=1, le=100_000)
    shortest_s: float = Field(ge=4, le=600)  # range of clip durations (log-uniform)
    longest_s: float = Field(ge=4, le=600)
    dialogue_share: float = Field(ge=0, le=1)  # fraction of sounds with a partner who takes turns
    liveliness: float = Field(gt=0, le=3)  # of gaze: rate and amplitude of shifts

    @model_validator(mode="after")
    def _source_fits(self) -> SourceSettings:
        least_s = self.shortest_s + MIN_LENGTH_RANGE_S
        if self.longest_s < least_s:
            raise bounds_error(
                f"longest_s should be at least shortest_s + {MIN_LENGTH_RANGE_S} ({least_s})", self.longest_s
            )
        if self.clips < self.speakers:
            raise bounds_error(f"clips should be at least speakers ({self.speakers})", self.clips)
        return self


class SplitSettings(Settings):
    """Fraction of the speakers that is unseen, and fractions of the other speakers' sounds in val and test."""

    unseen_speakers: float = Field(gt=0, lt=1)
    val: float = Field(gt=0, lt=0.5)
    test: float = Field(gt=0, lt=0.5)


class SynthesizeSettings(SourceSettings):
    """The synthetic corpus: texts, voices, motion, noise. Its inherited keys describe the first source."""

    seed: int = Field(ge=0)
    clips: int = Field(ge=10, le=10_000_000)
    speakers: int = Field(ge=4, le=100_000)
    splits: SplitSettings
    source: str = Field(pattern=r"^\w+$")
    further_sources: dict[str, SourceSettings]
    takes: int = Field(ge=1, le=100)  # takes per multi-take sound: same sound, motion sampled anew
    multi_take_sounds: int = Field(ge=0)  # number in the test split, and number in the unseen split
    fps: float = Field(ge=5, le=500)  # of motion and observations
    blinks: Literal["physiological", "paper"]  # blink profile
    # Gaze as recorded in pairs face to face and interviews, or in remote calls.
    population: Literal["face_to_face", "remote_call"]
    speech_coupling: float = Field(ge=0, le=1)  # of gaze, head and brows to speech: factor on that of each speaker
    cue_delay_s: float = Field(ge=-2, le=2)  # of the cues that speech gives to gaze
    individuality: float = Field(ge=0, le=3)  # additional differences between speakers in head motion
    languages: tuple[str, ...] = Field(min_length=1)  # speakers are assigned to them in turn
    voices: tuple[str, ...]  # of espeak-ng, such as en-us+f3; empty: all of these languages
    neutral_share: float = Field(ge=0, le=1)  # of sounds; the others have one of seven emotions
    acoustics: AcousticsSettings
    camera: CameraSettings
    noise: NoiseSettings

    @model_validator(mode="after")
    def _fits(self) -> SynthesizeSettings:
        if self.source in self.further_sources:
            raise bounds_error(f"further_sources should have other names than {self.source}", self.source)
        if unknown := set(self.languages) - set(languages()):
            raise bounds_error(f"languages should be among {', '.join(languages())}", ", ".join(sorted(unknown)))
        for voice in self.voices:
            if not is_voice(voice):
                raise bounds_error(f"voices should be {VOICE_NAMES}", voice)
        for language in self.languages if self.voices else ():
            if not any(voice.partition("+")[0] in ACCENTS[language] for voice in self.voices):
                raise bounds_error(
                    f"voices should have one for {language} ({', '.join(ACCENTS[language])})", ", ".join(self.voices)
                )
        return self

    @property
    def blink_profile(self) -> BlinkProfile:
        """The blink profile named by `blinks`."""
        return PROFILES[self.blinks]

    @property
    def sources(self) -> Mapping[str, SourceSettings]:
        """All sources by name."""
        return {self.source: self, **self.further_sources}


@dataclass(frozen=True)
class PlannedSound:
    """A planned sound: speaker, emotion, and whether a partner speaks too."""

    index: int
    speaker: int
    id: str
    source: str
    emotion: str
    intensity: int
    listening: bool


def seeded_generator(seed: int, stream: str, index: int, take: int = 0) -> np.random.Generator:
    """Random generator of one sampling step; motion and sound have separate streams."""
    return np.random.default_rng([seed, STREAMS[stream], index, take])


def plan_sounds(settings: SynthesizeSettings) -> list[PlannedSound]:
    """All sounds, source by source."""
    return [plan_sound(settings, index) for index in range(sum(each.clips for each in settings.sources.values()))]


def plan_sound(settings: SynthesizeSettings, index: int) -> PlannedSound:
    """The sound of an index; speakers of a source alternate."""
    first_sound = first_speaker = 0
    for source, each in settings.sources.items():
        number = index - first_sound
        if number < each.clips:
            return _sound(settings, source, index, first_speaker + number % each.speakers)
        first_sound += each.clips
        first_speaker += each.speakers
    raise IndexError(f"should be below {first_sound}, got {index}")


def _sound(settings: SynthesizeSettings, source: str, index: int, speaker: int) -> PlannedSound:
    rng = seeded_generator(settings.seed, "scene", index)
    listening = bool(rng.random() < settings.sources[source].dialogue_share)
    emotion, intensity = "neutral", 0
    if rng.random() >= settings.neutral_share:
        emotion, intensity = EMOTIONS[rng.integers(1, len(EMOTIONS))], INTENSITIES[rng.integers(len(INTENSITIES))]
    return PlannedSound(index, speaker, f"{speaker_name(speaker)}-{index:06d}", source, emotion, intensity, listening)


def speaker_name(number: int) -> str:
    """The id of a speaker."""
    return f"s{number:04d}"


def speaker_of(settings: SynthesizeSettings, sound: PlannedSound) -> Speaker:
    """The speaker of a sound, the same in all sounds of that speaker."""
    rng = seeded_generator(settings.seed, "speaker", sound.speaker)
    speaker = sample_speaker(
        speaker_name(sound.speaker),
        _language(settings, sound),
        rng,
        settings.blink_profile,
        settings.sources[sound.source].liveliness,
        settings.voices,
    )
    own = seeded_generator(settings.seed, "individual", sound.speaker)
    style = individualise_style(speaker.style, settings.individuality, own)
    coupling = settings.speech_coupling * style.speech_coupling
    style = replace(style, speech_coupling=coupling, cue_delay_s=settings.cue_delay_s)
    if settings.population != "face_to_face":
        style = with_habits(style, settings.population, seeded_generator(settings.seed, "habits", sound.speaker))
    return replace(speaker, style=style)


def dialogue_voices(settings: SynthesizeSettings, sound: PlannedSound) -> DialogueVoices:
    """Voices of a sound: the speaker's, in the emotion of the sound, and a partner's, sampled for this sound."""
    voice = apply_emotion(speaker_of(settings, sound).voice, sound.emotion, sound.intensity)
    if not sound.listening:
        return DialogueVoices(voice)
    rng = seeded_generator(settings.seed, "partner", sound.index)
    return DialogueVoices(voice, sample_voice(rng, _language(settings, sound), settings.voices))


def _language(settings: SynthesizeSettings, sound: PlannedSound) -> str:
    return settings.languages[sound.speaker % len(settings.languages)]
