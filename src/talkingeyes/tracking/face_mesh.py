"""Landmarks and iris centres of one face per frame: MediaPipe 0.10.21 FaceMesh with refined landmarks.

The 45 landmarks of the open head (LANDMARK_NAMES) are selected from the 478 of MediaPipe by the table below: by the
name of a point, and if several points fit, by the smallest distance on the mean of 16 real faces. The mesh runs on a
square window around the face, so a small face in a large image is tracked as well as a large one, and MediaPipe's
assumption of square regions holds. Kartynnik et al. 2019 (arXiv 1907.06724), Grishchenko et al. 2020 (arXiv
2006.10962).
"""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.head.landmark_definitions import EYE_POINTS, LANDMARK_NAMES

# The subject's left, then right, in the order of EYE_POINTS; MediaPipe's "left" is the subject's too.
_EYES = {"left": (263, 387, 385, 362, 380, 373), "right": (33, 160, 158, 133, 153, 144)}
_PAIRED = {
    "brow_outer": (293, 63),
    "brow_middle": (334, 105),
    "brow_inner": (336, 107),
    "nose_wing": (327, 98),
    "mouth_corner": (291, 61),
    "outline_temple": (389, 162),
    "outline_ear": (356, 127),
    "outline_lobe": (323, 93),
    "outline_angle": (288, 58),
    "outline_jaw_back": (397, 172),
    "outline_jaw": (379, 150),
    "outline_jaw_front": (400, 176),
}
_MIDDLE = {
    "nose_bridge": 168,
    "nose_middle": 195,
    "nose_tip": 1,
    "nose_base": 2,
    "upper_lip": 0,
    "upper_lip_inner": 13,
    "lower_lip_inner": 14,
    "lower_lip": 17,
    "outline_chin": 152,
}
MESH_INDICES: dict[str, int] = {
    **{f"{side}_eye_{point}": at for side, row in _EYES.items() for point, at in zip(EYE_POINTS, row, strict=True)},
    **{f"left_{name}": left for name, (left, _) in _PAIRED.items()},
    **{f"right_{name}": right for name, (_, right) in _PAIRED.items()},
    **_MIDDLE,
}
LANDMARK_INDICES = np.array([MESH_INDICES[name] for name in LANDMARK_NAMES])
IRIS_INDICES = np.array([473, 468])  # iris centres: left, right
MAX_SIDE_PX = 512  # largest side of a window, and of the image for face detection
WINDOW_MARGIN = 0.04  # fraction of a window: a face closer to its edge has moved out of it


class FaceDetectionSettings(Settings):
    """Thresholds for detection. Sizes are relative to the main face, window sizes to its width."""

    min_confidence: Annotated[float, Field(gt=0, lt=1)]
    window: Annotated[float, Field(ge=1.2, le=5)]
    detection_interval_s: Annotated[float, Field(gt=0)]
    second_face_ratio: Annotated[float, Field(gt=0, le=1)]


@dataclass(frozen=True)
class Box:
    """A square in an image: its corner and side in pixels."""

    x: float
    y: float
    side: float

    @property
    def centre(self) -> Float[ndarray, " 2"]:
        """Its centre."""
        return np.array([self.x, self.y]) + self.side / 2


@dataclass(frozen=True)
class DetectedFace:
    """One face in pixels of the image; `faces`: number of faces at the last detection (0: none run on this frame)."""

    landmarks: Float[ndarray, "L 2"]
    pupils: Float[ndarray, "2 2"]
    faces: int

    @property
    def width_px(self) -> float:
        """The larger side of the box around all landmarks."""
        return float(np.ptp(self.landmarks, axis=0).max())


class FaceMesh:
    """MediaPipe's detectors and mesh, with the current window. The state is independent of anything before `reset`."""

    def __init__(self, settings: FaceDetectionSettings) -> None:
        self._settings = settings
        self._has_seen = False
        with _suppress_stderr(), _suppress_warnings():
            self._load(_mediapipe())
        self.reset()

    def _load(self, solutions: Any) -> None:
        self._mesh = solutions.face_mesh.FaceMesh(refine_landmarks=True, max_num_faces=1)
        # The first detector covers faces at any distance but misses some that fill the image; the second is for those.
        score = self._settings.min_confidence
        self._detectors = [solutions.face_detection.FaceDetection(score, range_) for range_ in (1, 0)]
        for network in (self._mesh, *self._detectors):  # initialises, and logs, in separate threads
            network.process(np.zeros((64, 64, 3), np.uint8))

    def reset(self) -> None:
        """Detect the face anew: the next frame belongs to another shot."""
        self._window: Box | None = None
        self._checked_s = -np.inf

    def detect(self, image: UInt8[ndarray, "H W 3"], time_s: float) -> DetectedFace | None:
        """The face in a frame, or None."""
        if self._has_seen:
            return self._detect(image, time_s)
        with _suppress_stderr(), _suppress_warnings():  # the networks log on their first detection
            return self._detect(image, time_s)

    def _detect(self, image: UInt8[ndarray, "H W 3"], time_s: float) -> DetectedFace | None:
        counted = 0
        if self._window is None or time_s >= self._checked_s + self._settings.detection_interval_s:
            boxes = self.boxes(image)
            if not boxes and self._window is None:
                return None
            self._checked_s, counted = time_s, _visible(boxes, self._settings.second_face_ratio)
            if boxes and not any(self._window and _near(self._window, box) for box in boxes):
                self._set_window(boxes[0])
        face = self._in_window(image, counted)
        if face is None:
            self.reset()
        elif _leaves(face, self._window):
            span = np.stack([face.landmarks.min(axis=0), face.landmarks.max(axis=0)])
            corner = span.mean(axis=0) - face.width_px / 2
            self._set_window(Box(float(corner[0]), float(corner[1]), face.width_px))
        return face

    def boxes(self, image: UInt8[ndarray, "H W 3"]) -> list[Box]:
        """Squares around the faces found by any detector, without duplicates, the largest first."""
        small = _downscaled(image, MAX_SIDE_PX)
        found = [each for detector in self._detectors for each in detector.process(small).detections or []]
        faces: list[Box] = []
        for box in sorted((_box(each, image) for each in found), key=lambda box: -box.side):
            if all(np.abs(box.centre - face.centre).max() > face.side / 2 for face in faces):
                faces.append(box)
        return faces

    def close(self) -> None:
        """Release the networks' memory."""
        for network in (self._mesh, *self._detectors):
            network.close()

    def _set_window(self, box: Box) -> None:
        side = box.side * self._settings.window
        corner = box.centre - side / 2
        self._window = Box(float(corner[0]), float(corner[1]), side)
        # The mesh tracks from its last position; an image without a face makes it detect again.
        self._mesh.process(np.zeros((64, 64, 3), np.uint8))

    def _in_window(self, image: UInt8[ndarray, "H W 3"], counted: int) -> DetectedFace | None:
        window = self._window
        assert window is not None
        found = self._mesh.process(_cut(image, window)).multi_face_landmarks
        if not found:
            return None
        self._has_seen = True
        points = np.array([(point.x, point.y) for point in found[0].landmark])
        points = points * window.side + (window.x, window.y)
        return DetectedFace(points[LANDMARK_INDICES], points[IRIS_INDICES], counted)


def _box(detection: Any, image: UInt8[ndarray, "H W 3"]) -> Box:
    height, width = image.shape[:2]
    at = detection.location_data.relative_bounding_box
    side = max(at.width * width, at.height * height)
    return Box((at.xmin + at.width / 2) * width - side / 2, (at.ymin + at.height / 2) * height - side / 2, side)


def _visible(boxes: list[Box], second_face_ratio: float) -> int:
    return sum(box.side >= second_face_ratio * boxes[0].side for box in boxes)


def _near(window: Box, box: Box) -> bool:
    """Whether a window contains the face of a box completely and at sufficient size."""
    inside = np.abs(box.centre - window.centre).max() + box.side / 2 <= window.side / 2
    return bool(inside) and box.side * 5 > window.side


def _leaves(face: DetectedFace, window: Box | None) -> bool:
    assert window is not None
    corner = np.array([window.x, window.y])
    low, high = corner + WINDOW_MARGIN * window.side, corner + (1 - WINDOW_MARGIN) * window.side
    return bool((face.landmarks < low).any() or (face.landmarks > high).any())


def _cut(image: UInt8[ndarray, "H W 3"], box: Box) -> UInt8[ndarray, "S S 3"]:
    """The square of an image at its resolution, at most MAX_SIDE_PX; black outside the image."""
    import cv2

    side = min(max(round(box.side), 16), MAX_SIDE_PX)
    scale = box.side / side
    onto = np.array([[scale, 0, box.x + (scale - 1) / 2], [0, scale, box.y + (scale - 1) / 2]])
    how = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.warpAffine(image, onto, (side, side), flags=how | cv2.WARP_INVERSE_MAP))


def _downscaled(image: UInt8[ndarray, "H W 3"], largest_px: int) -> UInt8[ndarray, "h w 3"]:
    import cv2

    scale = largest_px / max(image.shape[:2])
    if scale >= 1:
        return image
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _mediapipe() -> Any:
    """The legacy solutions with their models. Raises InputError if the extra is not installed."""
    try:
        from mediapipe.python import solutions
    except ImportError as error:
        raise InputError(
            "track: mediapipe 0.10.21 (for Python 3.11 and 3.12) and OpenCV should be installed (the extra `track`), "
            f"got none ({error})"
        ) from None
    return solutions


@contextlib.contextmanager
def _suppress_warnings() -> Iterator[None]:
    """Suppress protobuf's warnings about itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def _suppress_stderr() -> Iterator[None]:
    """Suppress MediaPipe's C++ output on stderr, which ignores log levels."""
    sys.stderr.flush()
    stderr = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(nowhere)
        os.close(stderr)
