"""What a client may ask for, and how much of it: everything else it says is refused with one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from talkingeyes.animation.direction import MOST_LIVELY, Direction, Liveliness
from talkingeyes.core.settings import Settings
from talkingeyes.models.face.style import Style, StyleKey

Dial = Annotated[float, Field(ge=0, le=MOST_LIVELY)]


class Wish(Settings):
    """A performance, live or of a file; person, contact, emotion and intensity are those of a file."""

    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    person: Annotated[str, Field(max_length=100)] | None = None
    fps: Annotated[float, Field(ge=10, le=120)] = 25.0
    blinks: Literal["physio", "paper", "corpus"] = "physio"
    lively_head: Dial = 1.0
    lively_gaze: Dial = 1.0
    lively_blinks: Dial = 1.0
    contact: Annotated[float, Field(ge=0, le=1)] | None = None
    emotion: Annotated[str, Field(pattern="^[a-z]{1,20}$")] = "neutral"
    intensity: Annotated[int, Field(ge=0, le=3)] = 0

    @property
    def liveliness(self) -> Liveliness:
        """The dials."""
        return Liveliness(self.lively_head, self.lively_gaze, self.lively_blinks)

    @property
    def direction(self) -> Direction:
        """All of it but seed and rate. Raises InputError for an emotion or an intensity that there is not."""
        face = (StyleKey(0.0, Style(None, self.emotion, self.intensity)),)
        return Direction(
            blinks=self.blinks, person=self.person, contact=self.contact, liveliness=self.liveliness, face=face
        )


@dataclass(frozen=True)
class Limits:
    """What the service takes on."""

    streams: int  # at once
    stream_s: float  # of sound in one stream
    files: int  # performances and downloads that are computed at once; twice as many may wait
    speech_s: float  # of sound in one file
    upload_bytes: int
    work_s: float  # that one performance or download may take
    idle_s: float  # that a client may keep the service waiting
    kept: int  # performances, the oldest of which goes


@dataclass(frozen=True)
class Played:
    """What a worker answers to sound: `count` frames; before their rows, the number of the first (4 bytes)."""

    count: int
    rows: bytes
