"""Settings of the stage `track`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from talkingeyes.core.settings import Settings
from talkingeyes.tracking.clip_filter import ClipFilterSettings
from talkingeyes.tracking.cropping import CropSettings
from talkingeyes.tracking.face_mesh import FaceDetectionSettings
from talkingeyes.tracking.shots import ShotSettings
from talkingeyes.tracking.visibility import EyeVisibilitySettings


class TrackSettings(Settings):
    """Settings of tracking. `seed`: of the splits; `thumbnails`: whether to write small images of real faces.

    `source` and `licence` are copied to the index.
    """

    fps: Annotated[float, Field(ge=10, le=120)]
    max_fps: Annotated[float, Field(ge=10, le=240)]
    seed: Annotated[int, Field(ge=0)]
    thumbnails: bool
    source: str
    licence: str
    max_attempts: Annotated[int, Field(ge=1)]
    face: FaceDetectionSettings
    shot: ShotSettings
    crop: CropSettings
    eyes: EyeVisibilitySettings
    clip_filter: ClipFilterSettings
