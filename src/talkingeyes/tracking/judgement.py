"""Which shots become clips, and why the others do not (paper, III-A1: 20,000 clips became 6,000).

All that can be judged from a shot alone: its length, faces, sharpness, eyes, movement, voice. Copies of other clips are
found when all are known (footage.py), by the fingerprint that is taken here.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.audio.speaking import speaking
from talkingeyes.audio.waveform import SAMPLE_RATE, SILENT_DBFS, loudest_dbfs
from talkingeyes.core.settings import Settings
from talkingeyes.head.face_points import NAMES
from talkingeyes.head.observation import Observation
from talkingeyes.tracking.mouth import agreement, lip_gap
from talkingeyes.tracking.shots import Shot
from talkingeyes.tracking.visibility import EyeSettings, openings, turned_away

Share = Annotated[float, Field(ge=0, le=1)]
FINGERPRINT_FRAMES = 128
SAME_LEVEL = 0.05  # mean change of grey (of 255) of a face that is the same picture again


class KeepSettings(Settings):
    """What a clip must be. Sharpness is that of `shots.sharpness`; movement is in pixels of the crop."""

    least_s: Annotated[float, Field(ge=0.5)]
    several_faces: Share
    least_face_px: Annotated[float, Field(ge=0)]
    least_sharpness: Annotated[float, Field(ge=0)]
    hidden_eyes: Share
    least_movement_px: Annotated[float, Field(ge=0)]
    repeated: Share
    voice: bool
    least_speaking: Share
    least_agreement: Annotated[float, Field(ge=-1, le=1)]
    copy_bits: Share


@dataclass(frozen=True)
class Measures:
    """What a shot was judged by. `agreement` is 0 and `speaking` 0 where there is no sound to judge."""

    seconds: float
    several_faces: float
    face_px: float
    sharpness: float
    hidden_eyes: float
    movement_px: float
    repeated: float
    loudest_dbfs: float
    speaking: float
    agreement: float


def measured(shot: Shot, seen: Observation, sound: Float[ndarray, " N"], eyes: EyeSettings) -> Measures:
    """All measures of a shot, its observation and its stretch of sound."""
    faces = [look.face for look in shot.looks if look.face is not None]
    counts = [face.faces for face in faces if face.faces]
    loudest = loudest_dbfs(sound)
    heard = loudest >= SILENT_DBFS
    spoken_s = sum(span.end_s - span.start_s for span in speaking(sound).speaking) if heard else 0.0
    return Measures(
        seconds=len(seen.landmarks) / seen.fps,
        several_faces=float(np.mean([count > 1 for count in counts])) if counts else 0.0,
        face_px=float(np.median([face.width_px for face in faces])),
        sharpness=float(np.median([look.sharpness for look in shot.looks if look.face is not None])),
        hidden_eyes=float(turned_away(seen.landmarks, eyes).any(axis=1).mean()),
        movement_px=float(np.nanstd(seen.landmarks, axis=0).mean()),
        repeated=_repeated(shot),
        loudest_dbfs=loudest,
        speaking=spoken_s * SAMPLE_RATE / len(sound),
        agreement=agreement(seen.landmarks, sound, seen.fps) if heard else 0.0,
    )


def rejection(of: Measures, settings: KeepSettings) -> str:
    """Why a shot is no clip; empty if it is one."""
    silent = of.loudest_dbfs < SILENT_DBFS
    tests = (
        (of.seconds < settings.least_s, f"too short: {of.seconds:.2f} s, should be {settings.least_s:g} s"),
        (of.several_faces > settings.several_faces, f"more than one face: in {of.several_faces:.0%} of it"),
        (of.face_px < settings.least_face_px, f"too small: a face of {of.face_px:.0f} px"),
        (of.sharpness < settings.least_sharpness, f"too blurred: sharpness {of.sharpness:.3f}"),
        (of.hidden_eyes > settings.hidden_eyes, f"an eye is hidden: turned away in {of.hidden_eyes:.0%} of it"),
        (of.movement_px < settings.least_movement_px, f"too still: the face moves by {of.movement_px:.2f} px"),
        (of.repeated > settings.repeated, f"too still: {of.repeated:.0%} of the pictures repeat the one before"),
        (settings.voice and silent, "no voice: no sound, or silence"),
        (
            settings.voice and of.speaking < settings.least_speaking,
            f"no voice: it speaks in {of.speaking:.0%} of the time",
        ),
        (
            settings.voice and of.agreement < settings.least_agreement,
            f"not this face's voice: mouth and sound agree by {of.agreement:.2f}",
        ),
    )
    return next((reason for fails, reason in tests if fails), "")


def fingerprint(landmarks: Float[ndarray, "T L 2"]) -> str:
    """512 bits as hexadecimal digits: where nose, lips and lids are above their medians, at 128 times of the shot.

    Another codec, size, crop or frame rate leaves it nearly as it is; other footage of the same person in the same
    place differs in half of the bits.
    """
    nose = landmarks[:, NAMES.index("nose_tip")]
    eye = openings(landmarks, 50.0).mean(axis=1)
    course = np.stack([nose[:, 0], nose[:, 1], lip_gap(landmarks), np.nan_to_num(eye)], axis=1)
    chosen = np.linspace(0, len(course) - 1, FINGERPRINT_FRAMES).round().astype(int)
    bits = course[chosen] > np.nanmedian(course, axis=0)
    return np.packbits(bits.ravel()).tobytes().hex()


def differing(one: str, other: str) -> float:
    """The share of bits in which two fingerprints differ."""
    bits = int(one, 16) ^ int(other, 16)
    return bits.bit_count() / (4 * len(one))


def _repeated(shot: Shot) -> float:
    small = [look.small for look in shot.looks if look.face is not None]
    changes = [np.abs(b.astype(np.int16) - a).mean() for a, b in pairwise(small)]
    return float(np.mean(np.array(changes) < SAME_LEVEL)) if changes else 1.0
