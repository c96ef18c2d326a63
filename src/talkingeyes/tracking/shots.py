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
from talkingeyes.tracking.face_mesh import Face
from talkingeyes.tracking.video import Frame

Positive = Annotated[float, Field(gt=0)]
OVERVIEW = (32, 18)  # width and height of the small picture in which scene changes are looked for
FACE_PX = 128  # of the face's picture, in which sharpness is measured
SMALL_PX = 16  # of the face's picture that tells copies


class ShotSettings(Settings):
    """What ends a shot. `cut_level`: mean change of grey (of 255) between frames; `jump`: of face widths."""

    cut_level: Positive
    jump: Positive
    longest_loss_s: Positive
    longest_s: Annotated[float, Field(ge=2)]


@dataclass(frozen=True)
class Look:
    """One frame of a shot: the face if it was seen, how sharp it is and how it looks from afar."""

    time_s: float
    face: Face | None
    sharpness: float
    small: UInt8[ndarray, "s s"]


@dataclass(frozen=True)
class Shot:
    """Frames of one face; first and last have it. `ended` says by what, `next_s` at which frame: the next shot's
    beginning, or None at the end of the video. `picture` is a small one, in colour."""

    looks: list[Look]
    ended: str
    next_s: float | None
    picture: UInt8[ndarray, "P P 3"]

    @property
    def start_s(self) -> float:
        """When the first frame is."""
        return self.looks[0].time_s

    @property
    def stop_s(self) -> float:
        """When the last frame is."""
        return self.looks[-1].time_s


@runtime_checkable
class Eye(Protocol):
    """What looks for a face: FaceMesh, or a stand-in of the tests."""

    def see(self, picture: UInt8[ndarray, "H W 3"], time_s: float) -> Face | None:
        """The face of a frame."""

    def forget(self) -> None:
        """The next frame belongs to another shot."""


def shots(frames: Iterable[Frame], eye: Eye, settings: ShotSettings) -> Iterator[Shot]:
    """Shots in their order. Frames without a face lie between them."""
    looks: list[Look] = []
    thumbnail = before = None
    for frame in frames:
        overview = _grey(frame.picture, OVERVIEW)
        ended = _ended_before(frame, overview, before, looks, settings)
        before = overview
        if ended:
            yield from _shot(looks, ended, frame.time_s, thumbnail)
            looks, thumbnail = [], None
            eye.forget()
        face = eye.see(frame.picture, frame.time_s)
        if face is not None and _jumped(face, looks, settings.jump):
            yield from _shot(looks, "the face jumped", frame.time_s, thumbnail)
            looks, thumbnail = [], None
            eye.forget()
            face = eye.see(frame.picture, frame.time_s)
        if face is None:
            if looks:
                looks.append(Look(frame.time_s, None, 0.0, np.zeros((SMALL_PX, SMALL_PX), np.uint8)))
            continue
        picture = cut_face(frame.picture, face, FACE_PX)
        thumbnail = picture if thumbnail is None else thumbnail
        looks.append(Look(frame.time_s, face, sharpness(_grey(picture, None)), _grey(picture, (SMALL_PX, SMALL_PX))))
    yield from _shot(looks, "the video ended", None, thumbnail)


def cut_face(picture: UInt8[ndarray, "H W 3"], face: Face, side_px: int) -> UInt8[ndarray, "S S 3"]:
    """The face alone, at one size."""
    import cv2

    middle = (face.landmarks.min(axis=0) + face.landmarks.max(axis=0)) / 2
    scale = face.width_px / side_px
    corner = middle - face.width_px / 2 + (scale - 1) / 2
    onto = np.array([[scale, 0, corner[0]], [0, scale, corner[1]]])
    how = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.warpAffine(picture, onto, (side_px, side_px), flags=how | cv2.WARP_INVERSE_MAP))


def sharpness(grey: UInt8[ndarray, "S S"]) -> float:
    """Energy of the Laplacian over that of the picture itself: a blur lowers it, contrast does not change it."""
    import cv2

    spread = float(grey.std())
    return float(cv2.Laplacian(grey, cv2.CV_32F).std()) / spread if spread > 1 else 0.0


def _ended_before(
    frame: Frame,
    overview: UInt8[ndarray, "h w"],
    before: UInt8[ndarray, "h w"] | None,
    looks: list[Look],
    settings: ShotSettings,
) -> str:
    """Why the shot so far ends before this frame; empty if it goes on."""
    if before is not None and np.abs(overview.astype(np.int16) - before).mean() > settings.cut_level:
        return "the scene changed"
    if not looks:
        return ""
    if frame.time_s - looks[-1].time_s > settings.longest_loss_s:
        return "frames are missing"
    seen_s = next(look.time_s for look in reversed(looks) if look.face is not None)
    if frame.time_s - seen_s > settings.longest_loss_s:
        return "the face was lost"
    if frame.time_s - looks[0].time_s >= settings.longest_s:
        return "long enough"
    return ""


def _jumped(face: Face, looks: list[Look], jump: float) -> bool:
    last = looks[-1].face if looks else None
    if last is None:
        return False
    middle: Float[ndarray, " 2"] = face.landmarks.mean(axis=0) - last.landmarks.mean(axis=0)
    return bool(np.linalg.norm(middle) > jump * last.width_px)


def _shot(
    looks: list[Look], ended: str, next_s: float | None, picture: UInt8[ndarray, "P P 3"] | None
) -> Iterator[Shot]:
    """The shot without the frames at its end that had lost the face; nothing if there was none."""
    if picture is None:
        return
    last = max(index for index, look in enumerate(looks) if look.face is not None)
    yield Shot(looks[: last + 1], ended, next_s, picture)


def _grey(picture: UInt8[ndarray, "H W 3"], size: tuple[int, int] | None) -> UInt8[ndarray, "h w"]:
    import cv2

    smaller = picture if size is None else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(smaller, cv2.COLOR_RGB2GRAY))
