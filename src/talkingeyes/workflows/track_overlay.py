"""`talkingeyes track --overlay`: the fitted head beside the video.

Reads a tracked corpus and its videos. Writes overlay/<clip>.mp4: on the left the tracked crop of the video, with
landmarks and pupils; on the right the open head with the fitted pose, gaze and lids, under the same camera, with the
sound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.head.observation import Observation
from talkingeyes.tracking.cropping import Crop
from talkingeyes.tracking.video import read_frames

MAGNIFICATION = 2  # scale of the film relative to the crop
MAX_FPS = 240.0
LANDMARK, PUPIL = (90, 220, 90), (255, 80, 60)


@dataclass(frozen=True)
class ClipLocation:
    """Location of a clip: its video, its start time there, its crop."""

    video: Path
    start_s: float
    crop: Crop


def overlay(root: Path, settings: FitSettings, task: tuple[Clip, ClipLocation]) -> Path:
    """Render one clip of a tracked corpus; returns the film."""
    from talkingeyes.head.anny import anny_head
    from talkingeyes.rendering.render import HeadRenderer
    from talkingeyes.rendering.video import write_video
    from talkingeyes.rendering.view import OrbitCamera

    clip, location = task
    corpus = Corpus(root)
    seen = corpus.observation(clip)
    motion = fit_clip(seen, settings).motion
    camera = replace(
        seen.camera,
        focal_px=seen.camera.focal_px * MAGNIFICATION,
        centre_px=(seen.camera.centre_px[0] * MAGNIFICATION, seen.camera.centre_px[1] * MAGNIFICATION),
        width=seen.camera.width * MAGNIFICATION,
        height=seen.camera.height * MAGNIFICATION,
    )
    heads = HeadRenderer(anny_head(), OrbitCamera(camera)).draw(motion)
    beside = (np.hstack(pair) for pair in zip(draw_landmarks(location, seen), heads, strict=False))
    path = root / "overlay" / f"{clip.id}.mp4"
    path.parent.mkdir(exist_ok=True)
    write_video(path, beside, seen.fps, corpus.speech(clip))
    return path


def draw_landmarks(location: ClipLocation, seen: Observation) -> Iterator[UInt8[ndarray, "H W 3"]]:
    """The crop of the video at each frame of the observation, with the detected points."""
    import cv2

    side = seen.camera.width * MAGNIFICATION
    scale = 1.0 / (location.crop.zoom * MAGNIFICATION)
    onto = np.array([[scale, 0, location.crop.x], [0, scale, location.crop.y]])
    shown = read_frames(location.video, MAX_FPS, location.start_s - 1e-3)
    now = following = next(shown)
    for index in range(len(seen.landmarks)):
        time_s = location.start_s + index / seen.fps
        while following.time_s <= time_s + 1e-3:
            now = following
            following = next(shown, replace(now, time_s=np.inf))
        image = cv2.warpAffine(now.image, onto, (side, side), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        image = np.ascontiguousarray(image)
        _dots(image, seen.landmarks[index], LANDMARK)
        _dots(image, seen.pupils[index], PUPIL)
        yield image


def _dots(image: UInt8[ndarray, "H W 3"], points: Float[ndarray, "K 2"], colour: tuple[int, int, int]) -> None:
    """Draw the detected points into the picture."""
    import cv2

    for x, y in points[np.isfinite(points).all(axis=1)] * MAGNIFICATION:
        cv2.circle(image, (round(float(x)), round(float(y))), 2, colour, -1, cv2.LINE_AA)
