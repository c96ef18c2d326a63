"""Requests that a client may send, and the limits of the service; invalid requests get a one-line error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from talkingeyes.animation.controls import MAX_LIVELINESS, Controls, Liveliness
from talkingeyes.core.settings import Settings
from talkingeyes.models.face.style import FaceStyle, StyleKey

LivelinessFactor = Annotated[float, Field(ge=0, le=MAX_LIVELINESS)]


class AnimationRequest(Settings):
    """Settings of an animation. Person, eye contact, emotion and intensity apply to files, not to live streams."""

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
        """Factors of liveliness."""
        return Liveliness(self.head_liveliness, self.gaze_liveliness, self.blink_liveliness)

    @property
    def controls(self) -> Controls:
        """All settings but seed and frame rate. Raises InputError for an unknown emotion or intensity."""
        face = (StyleKey(0.0, FaceStyle(None, self.emotion, self.intensity)),)
        return Controls(
            blinks=self.blinks, person=self.person, eye_contact=self.eye_contact, liveliness=self.liveliness, face=face
        )


class EyesRequest(Settings):
    """How the eyes of an animation go into a file of another program (workflows/add_eyes.py)."""

    keep_head: bool = False
    blend: Annotated[float, Field(ge=0, le=1)] = 1.0
    fps: Annotated[float, Field(ge=10, le=240)] | None = None


@dataclass(frozen=True)
class Limits:
    """Limits of the service."""

    streams: int  # simultaneous streams
    max_stream_s: float  # maximum length of a stream
    files: int  # animations and exports computed at once; twice as many may wait
    max_speech_s: float  # maximum length of the speech in a file
    max_upload_bytes: int
    work_timeout_s: float  # time limit of one animation or export
    idle_timeout_s: float  # time limit for the next message of a client
    max_results: int  # stored animations; the oldest is removed


@dataclass(frozen=True)
class PoseChunk:
    """Reply of a worker to a chunk of sound: `count` frames; `rows` starts with the index of the first (4 bytes)."""

    count: int
    rows: bytes
