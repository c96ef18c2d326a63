"""Selection of shots as clips, with reasons for rejection (paper, III-A1: 20,000 clips became 6,000).

The criteria depend on a single shot only: duration, faces, sharpness, eyes, movement, voice. Duplicates are found
later, when all shots are known (workflows/track.py), by the fingerprint computed here.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.audio.voice_activity import detect_speech
from talkingeyes.audio.waveform import SAMPLE_RATE, SILENT_DBFS, loudest_dbfs
from talkingeyes.core.settings import Settings
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES
from talkingeyes.head.observation import Observation
from talkingeyes.tracking.lip_sync import lip_gap, lip_sync_score
from talkingeyes.tracking.shots import Shot
from talkingeyes.tracking.visibility import EyeVisibilitySettings, eye_openness, self_occluded

Share = Annotated[float, Field(ge=0, le=1)]
FINGERPRINT_FRAMES = 128
DUPLICATE_FRAME_LEVEL = 0.05  # mean grey difference (of 255) below which a face image repeats the previous one


class ClipFilterSettings(Settings):
    """Criteria for clips. Sharpness is that of `shots.sharpness`; movement is in pixels of the crop."""

    min_duration_s: Annotated[float, Field(ge=0.5)]
    multi_face_ratio: Share
    min_face_width_px: Annotated[float, Field(ge=0)]
    min_sharpness: Annotated[float, Field(ge=0)]
    hidden_eye_ratio: Share
    min_movement_px: Annotated[float, Field(ge=0)]
    duplicate_frame_ratio: Share
    require_voice: bool
    min_speech_ratio: Share
    min_lip_sync: Annotated[float, Field(ge=-1, le=1)]
    max_duplicate_distance: Share


@dataclass(frozen=True)
class ShotQuality:
    """Measurements of a shot. `lip_sync_score` and `speaking` are 0 if the sound is missing or silent."""

    seconds: float
    multi_face_ratio: float
    face_width_px: float
    sharpness: float
    hidden_eye_ratio: float
    movement_px: float
    duplicate_frame_ratio: float
    loudest_dbfs: float
    speaking: float
    lip_sync_score: float


def measure_shot(
    shot: Shot, seen: Observation, sound: Float[ndarray, " N"], eyes: EyeVisibilitySettings
) -> ShotQuality:
    """Measure a shot from its frames, its observation and its sound."""
    faces = [tracked.face for tracked in shot.tracked_frames if tracked.face is not None]
    counts = [face.faces for face in faces if face.faces]
    loudest = loudest_dbfs(sound)
    spoken_s = sum(span.end_s - span.start_s for span in detect_speech(sound).speaking)
    return ShotQuality(
        seconds=len(seen.landmarks) / seen.fps,
        multi_face_ratio=float(np.mean([count > 1 for count in counts])) if counts else 0.0,
        face_width_px=float(np.median([face.width_px for face in faces])),
        sharpness=float(np.median([tracked.sharpness for tracked in shot.tracked_frames if tracked.face is not None])),
        hidden_eye_ratio=float(self_occluded(seen.landmarks, eyes).any(axis=1).mean()),
        movement_px=float(np.nanstd(seen.landmarks, axis=0).mean()),
        duplicate_frame_ratio=_duplicate_frame_ratio(shot),
        loudest_dbfs=loudest,
        speaking=spoken_s * SAMPLE_RATE / len(sound),
        lip_sync_score=lip_sync_score(seen.landmarks, sound, seen.fps) if loudest >= SILENT_DBFS else 0.0,
    )


def rejection_reason(of: ShotQuality, settings: ClipFilterSettings) -> str:
    """Reason to reject a shot; empty if it becomes a clip."""
    silent = of.loudest_dbfs < SILENT_DBFS
    tests = (
        (
            of.seconds < settings.min_duration_s,
            f"too short: {of.seconds:.2f} s, should be {settings.min_duration_s:g} s",
        ),
        (of.multi_face_ratio > settings.multi_face_ratio, f"more than one face: in {of.multi_face_ratio:.0%} of it"),
        (of.face_width_px < settings.min_face_width_px, f"too small: a face of {of.face_width_px:.0f} px"),
        (of.sharpness < settings.min_sharpness, f"too blurred: sharpness {of.sharpness:.3f}"),
        (
            of.hidden_eye_ratio > settings.hidden_eye_ratio,
            f"an eye is hidden: turned away in {of.hidden_eye_ratio:.0%} of it",
        ),
        (of.movement_px < settings.min_movement_px, f"too still: the face moves by {of.movement_px:.2f} px"),
        (
            of.duplicate_frame_ratio > settings.duplicate_frame_ratio,
            f"too still: {of.duplicate_frame_ratio:.0%} of the pictures repeat the one before",
        ),
        (settings.require_voice and silent, "no voice: no sound, or silence"),
        (
            settings.require_voice and of.speaking < settings.min_speech_ratio,
            f"no voice: it speaks in {of.speaking:.0%} of the time",
        ),
        (
            settings.require_voice and of.lip_sync_score < settings.min_lip_sync,
            f"not this face's voice: mouth and sound agree by {of.lip_sync_score:.2f}",
        ),
    )
    return next((reason for fails, reason in tests if fails), "")


def fingerprint(landmarks: Float[ndarray, "T L 2"]) -> str:
    """512 bits as hexadecimal digits: whether nose, lips and lids are above their medians, at 128 times of the shot.

    Another codec, size, crop or frame rate changes few bits; other footage of the same person in the same place differs
    in half of the bits.
    """
    nose = landmarks[:, LANDMARK_NAMES.index("nose_tip")]
    eye = eye_openness(landmarks, 50.0).mean(axis=1)
    course = np.stack([nose[:, 0], nose[:, 1], lip_gap(landmarks), np.nan_to_num(eye)], axis=1)
    chosen = np.linspace(0, len(course) - 1, FINGERPRINT_FRAMES).round().astype(int)
    bits = course[chosen] > np.nanmedian(course, axis=0)
    return np.packbits(bits.ravel()).tobytes().hex()


def hamming_distance(one: str, other: str) -> float:
    """Fraction of bits in which two fingerprints differ."""
    bits = int(one, 16) ^ int(other, 16)
    return bits.bit_count() / (4 * len(one))


def _duplicate_frame_ratio(shot: Shot) -> float:
    low_res = [tracked.low_res for tracked in shot.tracked_frames if tracked.face is not None]
    changes = [np.abs(b.astype(np.int16) - a).mean() for a, b in pairwise(low_res)]
    return float(np.mean(np.array(changes) < DUPLICATE_FRAME_LEVEL)) if changes else 1.0
