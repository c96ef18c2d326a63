"""The fitted head beside the video that it was fitted to: what `talkingeyes track --overlay` writes.

Reads a tracked corpus and its videos. Writes overlay/<clip>.mp4: at the left what the camera saw, cut as it was
tracked, with the landmarks and pupils; at the right the open head in the pose, gaze and lids that `fit` finds, under
the same camera, with the sound.
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
from talkingeyes.tracking.framing import Crop
from talkingeyes.tracking.video import frames

MAGNIFIED = 2  # pixels of the film for one of the crop
FASTEST_FPS = 240.0
LANDMARK, PUPIL = (90, 220, 90), (255, 80, 60)


@dataclass(frozen=True)
class Place:
    """Where a clip lies: its video, its first moment there, its crop."""

    video: Path
    start_s: float
    crop: Crop


def overlay(root: Path, settings: FitSettings, order: tuple[Clip, Place]) -> Path:
    """Film one clip of a tracked corpus; returns the film."""
    from talkingeyes.head.anny import open_head
    from talkingeyes.rendering.render import Painter
    from talkingeyes.rendering.video import write_video
    from talkingeyes.rendering.view import View

    clip, place = order
    corpus = Corpus(root)
    seen = corpus.observation(clip)
    motion = fit_clip(seen, settings).motion
    camera = replace(
        seen.camera,
        focal_px=seen.camera.focal_px * MAGNIFIED,
        centre_px=(seen.camera.centre_px[0] * MAGNIFIED, seen.camera.centre_px[1] * MAGNIFIED),
        width=seen.camera.width * MAGNIFIED,
        height=seen.camera.height * MAGNIFIED,
    )
    heads = Painter(open_head(), View(camera)).draw(motion)
    beside = (np.hstack(pair) for pair in zip(marked(place, seen), heads, strict=False))
    path = root / "overlay" / f"{clip.id}.mp4"
    path.parent.mkdir(exist_ok=True)
    write_video(path, beside, seen.fps, corpus.speech(clip))
    return path


def marked(place: Place, seen: Observation) -> Iterator[UInt8[ndarray, "H W 3"]]:
    """The crop of the video at each frame of the observation, with what was found in it."""
    import cv2

    side = seen.camera.width * MAGNIFIED
    scale = 1.0 / (place.crop.zoom * MAGNIFIED)
    onto = np.array([[scale, 0, place.crop.x], [0, scale, place.crop.y]])
    shown = frames(place.video, FASTEST_FPS, place.start_s - 1e-3)
    now = following = next(shown)
    for index in range(len(seen.landmarks)):
        time_s = place.start_s + index / seen.fps
        while following.time_s <= time_s + 1e-3:
            now = following
            following = next(shown, replace(now, time_s=np.inf))
        picture = cv2.warpAffine(now.picture, onto, (side, side), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        picture = np.ascontiguousarray(picture)
        _dots(picture, seen.landmarks[index], LANDMARK)
        _dots(picture, seen.pupils[index], PUPIL)
        yield picture


def _dots(picture: UInt8[ndarray, "H W 3"], points: Float[ndarray, "K 2"], colour: tuple[int, int, int]) -> None:
    """Draw the points that were seen into the picture."""
    import cv2

    for x, y in points[np.isfinite(points).all(axis=1)] * MAGNIFIED:
        cv2.circle(picture, (round(float(x)), round(float(y))), 2, colour, -1, cv2.LINE_AA)
