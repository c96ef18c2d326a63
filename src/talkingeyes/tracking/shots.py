"""Splits a video into shots of one face: at scene changes, lost faces, jumps in time or position, maximum duration.

Each shot is emitted when it ends and nothing older is kept, so memory does not grow with the video. The detector is
reset at each end, so a shot does not depend on where tracking started.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings
from talkingeyes.tracking.face_mesh import DetectedFace
from talkingeyes.tracking.video import Frame

Positive = Annotated[float, Field(gt=0)]
SCENE_SIZE_PX = (32, 18)  # width and height of the thumbnail for scene changes
FACE_PX = 128  # of the face image for sharpness
LOW_RES_PX = 16  # of the face image for repeated frames


class ShotSettings(Settings):
    """Criteria for ends of shots. `scene_change_level`: grey difference (of 255); `max_jump`: in face widths."""

    scene_change_level: Positive
    max_jump: Positive
    max_dropout_s: Positive
    max_duration_s: Annotated[float, Field(ge=2)]


@dataclass(frozen=True)
class TrackedFrame:
    """One frame of a shot: the face if detected, its sharpness, and a low-resolution image of it."""

    time_s: float
    face: DetectedFace | None
    sharpness: float
    low_res: UInt8[ndarray, "s s"]


@dataclass(frozen=True)
class Shot:
    """Frames of one face, starting and ending with a detection.

    `end_reason`: why the shot ended. `resume_s`: the frame at which it ended, where the next shot starts; None at the
    end of the video. `image`: a small colour image.
    """

    tracked_frames: list[TrackedFrame]
    end_reason: str
    resume_s: float | None
    image: UInt8[ndarray, "P P 3"]

    @property
    def start_s(self) -> float:
        """Time of the first frame."""
        return self.tracked_frames[0].time_s

    @property
    def stop_s(self) -> float:
        """Time of the last frame."""
        return self.tracked_frames[-1].time_s


@runtime_checkable
class FaceDetector(Protocol):
    """A face detector: FaceMesh, or a fake in tests."""

    def detect(self, image: UInt8[ndarray, "H W 3"], time_s: float) -> DetectedFace | None:
        """The face in a frame, or None."""

    def reset(self) -> None:
        """Start a new shot with the next frame."""


def detect_shots(frames: Iterable[Frame], detector: FaceDetector, settings: ShotSettings) -> Iterator[Shot]:
    """Shots in order; frames without a face are dropped between them."""
    tracked_frames: list[TrackedFrame] = []
    thumbnail = before = None
    for frame in frames:
        overview = _grey(frame.image, SCENE_SIZE_PX)
        end_reason = _ended_before(frame, overview, before, tracked_frames, settings)
        before = overview
        if end_reason:
            yield from _shot(tracked_frames, end_reason, frame.time_s, thumbnail)
            tracked_frames, thumbnail = [], None
            detector.reset()
        face = detector.detect(frame.image, frame.time_s)
        if face is not None and _jumped(face, tracked_frames, settings.max_jump):
            yield from _shot(tracked_frames, "the face jumped", frame.time_s, thumbnail)
            tracked_frames, thumbnail = [], None
            detector.reset()
            face = detector.detect(frame.image, frame.time_s)
        if face is None:
            if tracked_frames:
                tracked_frames.append(
                    TrackedFrame(frame.time_s, None, 0.0, np.zeros((LOW_RES_PX, LOW_RES_PX), np.uint8))
                )
            continue
        image = crop_face(frame.image, face, FACE_PX)
        thumbnail = image if thumbnail is None else thumbnail
        tracked_frames.append(
            TrackedFrame(frame.time_s, face, sharpness(_grey(image, None)), _grey(image, (LOW_RES_PX, LOW_RES_PX)))
        )
    yield from _shot(tracked_frames, "the video ended", None, thumbnail)


def crop_face(image: UInt8[ndarray, "H W 3"], face: DetectedFace, side_px: int) -> UInt8[ndarray, "S S 3"]:
    """The face alone, resized to a square."""
    import cv2

    middle = (face.landmarks.min(axis=0) + face.landmarks.max(axis=0)) / 2
    scale = face.width_px / side_px
    corner = middle - face.width_px / 2 + (scale - 1) / 2
    onto = np.array([[scale, 0, corner[0]], [0, scale, corner[1]]])
    how = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.warpAffine(image, onto, (side_px, side_px), flags=how | cv2.WARP_INVERSE_MAP))


def sharpness(grey: UInt8[ndarray, "S S"]) -> float:
    """Energy of the Laplacian relative to that of the image: blur lowers it, contrast does not change it."""
    import cv2

    spread = float(grey.std())
    return float(cv2.Laplacian(grey, cv2.CV_32F).std()) / spread if spread > 1 else 0.0


def _ended_before(
    frame: Frame,
    overview: UInt8[ndarray, "h w"],
    before: UInt8[ndarray, "h w"] | None,
    tracked_frames: list[TrackedFrame],
    settings: ShotSettings,
) -> str:
    """Why the current shot ends before this frame; empty if it continues."""
    if before is not None and np.abs(overview.astype(np.int16) - before).mean() > settings.scene_change_level:
        return "the scene changed"
    if not tracked_frames:
        return ""
    if frame.time_s - tracked_frames[-1].time_s > settings.max_dropout_s:
        return "frames are missing"
    seen_s = next(tracked.time_s for tracked in reversed(tracked_frames) if tracked.face is not None)
    if frame.time_s - seen_s > settings.max_dropout_s:
        return "the face was lost"
    if frame.time_s - tracked_frames[0].time_s >= settings.max_duration_s:
        return "long enough"
    return ""


def _jumped(face: DetectedFace, tracked_frames: list[TrackedFrame], max_jump: float) -> bool:
    last = tracked_frames[-1].face if tracked_frames else None
    if last is None:
        return False
    middle: Float[ndarray, " 2"] = face.landmarks.mean(axis=0) - last.landmarks.mean(axis=0)
    return bool(np.linalg.norm(middle) > max_jump * last.width_px)


def _shot(
    tracked_frames: list[TrackedFrame], end_reason: str, resume_s: float | None, image: UInt8[ndarray, "P P 3"] | None
) -> Iterator[Shot]:
    """The shot without trailing frames that had lost the face; nothing without any face."""
    if image is None:
        return
    last = max(index for index, tracked in enumerate(tracked_frames) if tracked.face is not None)
    yield Shot(tracked_frames[: last + 1], end_reason, resume_s, image)


def _grey(image: UInt8[ndarray, "H W 3"], size: tuple[int, int] | None) -> UInt8[ndarray, "h w"]:
    import cv2

    smaller = image if size is None else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(smaller, cv2.COLOR_RGB2GRAY))
