"""Requests that a client may send, and the limits of the service; invalid requests get a one-line error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from talkingeyes.animation.controls import MAX_LIVELINESS, Controls, Liveliness
from talkingeyes.core.settings import Settings
from talkingeyes.models.face.style import FaceStyle, StyleKey


def _liveliness(what: str) -> Any:
    return Field(ge=0, le=MAX_LIVELINESS, description=f"factor on the {what}")


class AnimationRequest(Settings):
    """Settings of an animation. Person, eye contact, emotion and intensity apply to files, not to live streams."""

    seed: Annotated[int, Field(ge=0, lt=2**31, description="each seed gives another sample")] = 0
    person: Annotated[str, Field(max_length=100, description="training speaker (service.json lists them)")] | None = (
        None
    )
    fps: Annotated[float, Field(ge=10, le=120, description="frames a second")] = 25.0
    blinks: Annotated[
        Literal["physiological", "paper", "corpus"], Field(description="where the blink rate is from")
    ] = "physiological"
    head_liveliness: Annotated[float, _liveliness("motion of the head")] = 1.0
    gaze_liveliness: Annotated[float, _liveliness("motion of the eyes")] = 1.0
    blink_liveliness: Annotated[float, _liveliness("blink rate")] = 1.0
    eye_contact: Annotated[float, Field(ge=0, le=1, description="share of time; by default the model's")] | None = None
    emotion: Annotated[
        str, Field(pattern="^[a-z]{1,20}$", description="one of service.json, with an intensity of 1 to 3")
    ] = "neutral"
    intensity: Annotated[int, Field(ge=0, le=3, description="of the emotion")] = 0

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

    keep_head: Annotated[bool, Field(description="keep the head motion of the file")] = False
    blend: Annotated[float, Field(ge=0, le=1, description="share of these eyes, the rest being the file's")] = 1.0
    fps: Annotated[float, Field(ge=10, le=240, description="of files that do not state theirs")] | None = None


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
