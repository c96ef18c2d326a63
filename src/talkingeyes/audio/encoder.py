"""Speech encoders: sound to one feature vector per motion frame, as written by `embed` and used by every model.

Each encoder family (packaged Moonshine, wav2vec 2.0, HuBERT, log-mel) provides its channels. Log-energy, F0 and voicing
are appended to all of them, because learned encoders represent loudness and pitch poorly, and then the boundaries of
speech (speech_boundaries.py). Sounds are first normalised to one level, so that features do not depend on recording
level.
"""

from __future__ import annotations

from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import BeforeValidator, Field, SerializeAsAny

from talkingeyes.audio.prosody import ProsodySettings, prosody
from talkingeyes.audio.speech_boundaries import BOUNDARY_CHANNELS, boundary_channels
from talkingeyes.audio.voice_activity import detect_speech
from talkingeyes.audio.waveform import block_levels_dbfs
from talkingeyes.core.settings import ComponentRegistry, ComponentSettings, Settings

ENCODERS = ComponentRegistry(
    "speech encoder",
    {
        "moonshine": "talkingeyes.audio.encoder_moonshine:MoonshineEncoder",
        "wav2vec2": "talkingeyes.audio.encoder_transformers:TransformersEncoder",
        "hubert": "talkingeyes.audio.encoder_transformers:TransformersEncoder",
        "logmel": "talkingeyes.audio.encoder_logmel:LogmelEncoder",
    },
    ("__call__",),
)

PROSODY_CHANNELS = ("energy_dbfs", "f0_octaves", "voicing")
F0_REFERENCE_HZ = 150.0
LOUD_PERCENTILE = 95  # the level of a sound is that of its loud syllables, independent of pauses
MAX_GAIN_DB = 60.0


class EmbedSettings(Settings):
    """The configuration section `embed`."""

    encoder: Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(ENCODERS.parse)]
    prosody: ProsodySettings
    level_dbfs: Annotated[float, Field(ge=-40, le=-6)]  # level of loud syllables to which every sound is normalised


@runtime_checkable
class SpeechEncoder(Protocol):
    """Maps 16 kHz sound and a frame rate to float32 (T, C): T = len(sound) * fps // 16000, row t at time t / fps.

    A family is constructed as `Class(settings)`.
    """

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the C channels."""

    def __call__(self, sound: Float[ndarray, " N"], fps: float) -> Float[ndarray, "T C"]:
        """Features of a sound at the times t / fps."""


class ProsodicEncoder:
    """An encoder family with level normalisation, channels of prosody, and boundaries of speech."""

    def __init__(self, family: SpeechEncoder, settings: EmbedSettings) -> None:
        self._family = family
        self._settings = settings
        self.channels = (*family.channels, *PROSODY_CHANNELS, *BOUNDARY_CHANNELS)

    def __call__(self, sound: Float[ndarray, " N"], fps: float) -> Float[ndarray, "T C"]:
        """Features of a sound at the times t / fps."""
        levelled = normalise_level(sound, self._settings.level_dbfs)
        spoken = prosody(levelled, fps, self._settings.prosody)
        # Unvoiced frames get the reference pitch; `voicing` marks them.
        octaves = np.nan_to_num(np.log2(spoken.f0_hz / F0_REFERENCE_HZ))
        levels = np.stack([spoken.energy_dbfs, octaves, spoken.voicing], axis=1)
        times_s = np.arange(len(levels)) / fps
        boundaries = boundary_channels(detect_speech(levelled).speaking, times_s)
        appended = np.concatenate([levels, boundaries], axis=1).astype(np.float32)
        return np.concatenate([self._family(levelled, fps), appended], axis=1)


def make_encoder(settings: EmbedSettings) -> SpeechEncoder:
    """Construct the encoder of a section. Raises InputError if its package or checkpoint is missing."""
    return ProsodicEncoder(ENCODERS.build(settings.encoder), settings)


def normalise_level(sound: Float[ndarray, " N"], level_dbfs: float) -> Float[ndarray, " N"]:
    """Scale a sound so that its loud syllables have the given level; digital silence is unchanged."""
    if not len(sound):
        return sound.astype(np.float32)
    gain_db = level_dbfs - float(np.percentile(block_levels_dbfs(sound), LOUD_PERCENTILE))
    gain_db = gain_db if gain_db <= MAX_GAIN_DB else 0.0
    return (sound * 10 ** (gain_db / 20)).astype(np.float32)
