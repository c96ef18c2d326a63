"""Data of the viewer's page besides the heads: traces, blinks and saccades, words, the waveform.

All values are plain numbers and texts, so that they form one JSON. Angles are in degrees: yaw positive to the subject's
left, pitch positive up; means of both eyes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Span
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.motion import Events, Motion

PEAKS_HZ = 100
MAX_PEAKS = 4000
NO_EVENTS = Events()


@dataclass(frozen=True)
class ViewerMotion:
    """A motion, its name on the page, its events if they are known, and whether it is the truth."""

    name: str
    motion: Motion
    events: Events = NO_EVENTS
    truth: bool = False


@dataclass(frozen=True)
class Scene:
    """Motions that play synchronously, with their common sound and words."""

    title: str
    viewer_motions: tuple[ViewerMotion, ...]
    sound: Float[ndarray, " N"] | None = None
    words: tuple[Span, ...] = ()

    @property
    def seconds(self) -> float:
        """Duration of the longest motion."""
        return max(viewer_motion.motion.seconds for viewer_motion in self.viewer_motions)


def scene_json(scene: Scene) -> dict[str, Any]:
    """The scene as JSON for the page."""
    return {
        "title": scene.title,
        "seconds": scene.seconds,
        "takes": [_motion_json(viewer_motion) for viewer_motion in scene.viewer_motions],
        "words": [[round(word.start_s, 3), round(word.end_s, 3), word.label] for word in scene.words],
        "outline": [] if scene.sound is None else waveform_peaks(scene.sound),
        "sound": scene.sound is not None,
    }


def traces(motion: Motion) -> dict[str, Float[ndarray, " T"]]:
    """Traces of gaze in space and head in degrees, and lid closure."""
    space = np.degrees(rotation.cyclopean_gaze(rotation.gaze_in_space(motion.head, motion.gaze)))
    head = np.degrees(rotation.gaze_to_angles(motion.head))
    return {
        "gaze_yaw_deg": space[:, 0],
        "gaze_pitch_deg": space[:, 1],
        "head_yaw_deg": head[:, 0],
        "head_pitch_deg": head[:, 1],
        "lid": motion.lid.mean(axis=1),
    }


def waveform_peaks(sound: Float[ndarray, " N"]) -> list[float]:
    """Peaks of equal segments, normalised to a maximum of 1."""
    columns = int(np.clip(len(sound) * PEAKS_HZ / SAMPLE_RATE, 1, MAX_PEAKS))
    edges = np.linspace(0, len(sound), columns, endpoint=False).astype(int)
    peaks = np.maximum.reduceat(np.abs(sound), edges)
    return [round(float(peak), 3) for peak in peaks / max(float(peaks.max()), 1e-9)]


def _motion_json(viewer_motion: ViewerMotion) -> dict[str, Any]:
    blinks = [[each.onset_s, each.closing_s + each.hold_s + each.opening_s] for each in viewer_motion.events.blinks]
    return {
        "name": viewer_motion.name,
        "truth": viewer_motion.truth,
        "fps": viewer_motion.motion.fps,
        "frames": len(viewer_motion.motion),
        "traces": {name: np.round(trace, 2).tolist() for name, trace in traces(viewer_motion.motion).items()},
        "saccades": [round(each.onset_s, 3) for each in viewer_motion.events.saccades],
        "blinks": [[round(onset, 3), round(onset + lasts, 3)] for onset, lasts in blinks],
    }
