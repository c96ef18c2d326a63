"""What a client may ask for, and how much of it: everything else it says is refused with one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from talkingeyes.animation.controls import MAX_LIVELINESS, Controls, Liveliness
from talkingeyes.core.settings import Settings
from talkingeyes.models.face.style import FaceStyle, StyleKey

LivelinessFactor = Annotated[float, Field(ge=0, le=MAX_LIVELINESS)]


class AnimationRequest(Settings):
    """A performance, live or of a file; person, eye contact, emotion and intensity are those of a file."""

    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    person: Annotated[str, Field(max_length=100)] | None = None
    fps: Annotated[float, Field(ge=10, le=120)] = 25.0
    blinks: Literal["physiological", "paper", "corpus"] = "physiological"
    head_liveliness: LivelinessFactor = 1.0
    gaze_liveliness: LivelinessFactor = 1.0
    blink_liveliness: LivelinessFactor = 1.0
    eye_contact: Annotated[float, Field(ge=0, le=1)] | None = None
    emotion: Annotated[str, Field(pattern="^[a-z]{1,20}$")] = "neutral"
    intensity: Annotated[int, Field(ge=0, le=3)] = 0

    @property
    def liveliness(self) -> Liveliness:
        """The dials."""
        return Liveliness(self.head_liveliness, self.gaze_liveliness, self.blink_liveliness)

    @property
    def controls(self) -> Controls:
        """All of it but seed and rate. Raises InputError for an emotion or an intensity that there is not."""
        face = (StyleKey(0.0, FaceStyle(None, self.emotion, self.intensity)),)
        return Controls(
            blinks=self.blinks, person=self.person, eye_contact=self.eye_contact, liveliness=self.liveliness, face=face
        )


@dataclass(frozen=True)
class Limits:
    """What the service takes on."""

    streams: int  # at once
    max_stream_s: float  # of sound in one stream
    files: int  # performances and downloads that are computed at once; twice as many may wait
    max_speech_s: float  # of sound in one file
    max_upload_bytes: int
    work_timeout_s: float  # that one performance or download may take
    idle_timeout_s: float  # that a client may keep the service waiting
    max_results: int  # performances, the oldest of which goes


@dataclass(frozen=True)
class PoseChunk:
    """What a worker answers to sound: `count` frames; before their rows, the number of the first (4 bytes)."""

    count: int
    rows: bytes
