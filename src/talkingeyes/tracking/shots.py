"""A video cut into shots of one face: at scene changes, lost faces, jumps in time or place, and at a longest length.

A shot is given out as soon as it ends, and nothing before it is kept, so memory does not grow with the video; the mesh
forgets at each end, so a shot is the same whether the video is tracked from its beginning or from there.
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
SCENE_SIZE_PX = (32, 18)  # width and height of the small picture in which scene changes are looked for
FACE_PX = 128  # of the face's picture, in which sharpness is measured
LOW_RES_PX = 16  # of the face's picture that tells copies


class ShotSettings(Settings):
    """What ends a shot. `scene_change_level`: change of grey (of 255) between frames; `max_jump`: of face widths."""

    scene_change_level: Positive
    max_jump: Positive
    max_dropout_s: Positive
    max_duration_s: Annotated[float, Field(ge=2)]


@dataclass(frozen=True)
class TrackedFrame:
    """One frame of a shot: the face if it was seen, how sharp it is and how it looks from afar."""

    time_s: float
    face: DetectedFace | None
    sharpness: float
    low_res: UInt8[ndarray, "s s"]


@dataclass(frozen=True)
class Shot:
    """Frames of one face; first and last have it. `end_reason` says by what, `resume_s` at which frame: the next shot's
    beginning, or None at the end of the video. `image` is a small one, in colour."""

    tracked_frames: list[TrackedFrame]
    end_reason: str
    resume_s: float | None
    image: UInt8[ndarray, "P P 3"]

    @property
    def start_s(self) -> float:
        """When the first frame is."""
        return self.tracked_frames[0].time_s

    @property
    def stop_s(self) -> float:
        """When the last frame is."""
        return self.tracked_frames[-1].time_s


@runtime_checkable
class FaceDetector(Protocol):
    """What looks for a face: FaceMesh, or a stand-in of the tests."""

    def detect(self, image: UInt8[ndarray, "H W 3"], time_s: float) -> DetectedFace | None:
        """The face of a frame."""

    def reset(self) -> None:
        """The next frame belongs to another shot."""


def shots(frames: Iterable[Frame], detector: FaceDetector, settings: ShotSettings) -> Iterator[Shot]:
    """Shots in their order. Frames without a face lie between them."""
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
    """The face alone, at one size."""
    import cv2

    middle = (face.landmarks.min(axis=0) + face.landmarks.max(axis=0)) / 2
    scale = face.width_px / side_px
    corner = middle - face.width_px / 2 + (scale - 1) / 2
    onto = np.array([[scale, 0, corner[0]], [0, scale, corner[1]]])
    how = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.warpAffine(image, onto, (side_px, side_px), flags=how | cv2.WARP_INVERSE_MAP))


def sharpness(grey: UInt8[ndarray, "S S"]) -> float:
    """Energy of the Laplacian over that of the picture itself: a blur lowers it, contrast does not change it."""
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
    """Why the shot so far ends before this frame; empty if it goes on."""
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
    """The shot without the frames at its end that had lost the face; nothing if there was none."""
    if image is None:
        return
    last = max(index for index, tracked in enumerate(tracked_frames) if tracked.face is not None)
    yield Shot(tracked_frames[: last + 1], end_reason, resume_s, image)


def _grey(image: UInt8[ndarray, "H W 3"], size: tuple[int, int] | None) -> UInt8[ndarray, "h w"]:
    import cv2

    smaller = image if size is None else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(smaller, cv2.COLOR_RGB2GRAY))
