"""Requests that a client may send, and the limits of the service; invalid requests get a one-line error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from talkingeyes.animation.controls import MAX_LIVELINESS, Controls, Liveliness
from talkingeyes.animation.conversation_states import State
from talkingeyes.animation.live_gaze import GazeDirection
from talkingeyes.animation.targets import CAMERA, LISTENER, STRAIGHT_AHEAD, check_reach
from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.models.face.style import FaceStyle, StyleKey, default_intensity


def _liveliness(what: str) -> Any:
    return Field(ge=0, le=MAX_LIVELINESS, description=f"factor on the {what}")


Emotion = Annotated[str, Field(pattern="^[a-z]{1,20}$", description="one of service.json")]
Intensity = Annotated[int, Field(ge=0, le=3, description="of the emotion, 1 to 3; by default 2")] | None


class AnimationRequest(Settings):
    """Settings of an animation. Person and frame rate apply to files, not to live streams."""

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
    emotion: Emotion = "neutral"
    intensity: Intensity = None

    @property
    def liveliness(self) -> Liveliness:
        """Factors of liveliness."""
        return Liveliness(self.head_liveliness, self.gaze_liveliness, self.blink_liveliness)

    @property
    def controls(self) -> Controls:
        """All settings but seed and frame rate. Raises InputError for an unknown emotion or intensity."""
        face = (StyleKey(0.0, self.face),)
        return Controls(
            blinks=self.blinks, person=self.person, eye_contact=self.eye_contact, liveliness=self.liveliness, face=face
        )

    @property
    def face(self) -> FaceStyle:
        """Style of the face. Raises InputError for an unknown emotion or intensity."""
        return FaceStyle(None, self.emotion, default_intensity(self.emotion, self.intensity))


Target = Annotated[
    Literal["camera", "listener"] | tuple[float, float, float] | None,
    Field(description="what gaze is at: camera, listener, [x, y, z] in metres (left, up, ahead), or null"),
]
StreamState = Annotated[
    State | None,
    Field(description="eye contact 0.95 listening, 0.2 thinking, 0.6 idle; speaking or null: the model's own"),
]


def _check_target(value: Any) -> Any:
    """A name, a point within reach, or None. Raises an error of pydantic for anything else."""
    if value is None or (isinstance(value, str) and value in (CAMERA, LISTENER)):
        return value
    numbers = isinstance(value, list | tuple) and all(isinstance(each, float | int) for each in value)
    if not numbers or len(value) != 3:
        raise bounds_error(f"should be {CAMERA}, {LISTENER}, [x, y, z] in metres, or null", value)
    try:
        check_reach("the point", value, "world")
    except ValueError as error:
        requirement, _, distance = str(error).rpartition(", got ")
        raise bounds_error(requirement, distance) from None
    return tuple(value)


class StreamRequest(AnimationRequest):
    """The first message of a stream."""

    format: Annotated[Literal["binary", "json"], Field(description="form of the frames")] = "binary"
    channels: Annotated[
        int, Field(ge=1, le=2, description="of the sound; with 2, the second is the partner's, which nods answer")
    ] = 1
    target: Target = None
    state: StreamState = None

    _target_in_reach = field_validator("target", mode="before")(_check_target)

    @property
    def gaze(self) -> GazeDirection:
        """What directs gaze."""
        ahead = STRAIGHT_AHEAD.positions[0][:3] if self.target in (CAMERA, LISTENER) else None
        point = self.target if isinstance(self.target, tuple) else None
        return GazeDirection(self.eye_contact, ahead or point, self.state)


class StreamChanges(Settings):
    """What can be changed while a stream runs: {"set": {...}}. A key that is absent stays as it is."""

    head_liveliness: Annotated[float, _liveliness("motion of the head")] = 1.0
    gaze_liveliness: Annotated[float, _liveliness("motion of the eyes")] = 1.0
    eye_contact: Annotated[float, Field(ge=0, le=1, description="share of time; null: the model's")] | None = None
    target: Target = None
    state: StreamState = None
    emotion: Emotion = "neutral"
    intensity: Intensity = None

    _target_in_reach = field_validator("target", mode="before")(_check_target)

    def applied_to(self, request: StreamRequest) -> StreamRequest:
        """The request with the keys that were given; another emotion has the default intensity."""
        names = self.model_fields_set | ({"intensity"} if "emotion" in self.model_fields_set else set())
        return request.model_copy(update={name: getattr(self, name) for name in names})


class EyesRequest(Settings):
    """How the eyes of an animation go into a file of another program (workflows/add_eyes.py)."""

    keep_head: Annotated[bool, Field(description="keep the head motion of the file")] = False
    blend: Annotated[float, Field(ge=0, le=1, description="share of these eyes, the rest being the file's")] = 1.0
    fps: Annotated[float, Field(ge=10, le=240, description="of files that do not state theirs")] | None = None


@dataclass(frozen=True)
class Limits:
    """Limits of the service."""

    streams: int  # simultaneous streams, if their measured load allows so many
    max_stream_s: float  # maximum length of a stream
    files: int  # animations and exports computed at once; twice as many may wait
    max_speech_s: float  # maximum length of the speech in a file
    max_upload_bytes: int
    work_timeout_s: float  # time limit of one animation or export
    idle_timeout_s: float  # time limit for the next message of a client
    max_results: int  # stored animations; the oldest is removed


@dataclass(frozen=True)
class PoseChunk:
    """Reply of a worker to a chunk of sound: `count` frames, as bytes (index of the first, rows) or as JSON."""

    count: int
    rows: bytes | str


@dataclass(frozen=True)
class StepReply:
    """Reply of a worker to the requests of many streams: seconds of their step, and an answer or an error for each."""

    step_s: float
    answers: list[Any]
