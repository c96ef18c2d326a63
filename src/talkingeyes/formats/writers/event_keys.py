"""Saccades and blinks of a motion as sparse keys for editing: the known events of the motion, or detected ones.

`talkingeyes animate` writes the events of a motion beside it (NAME.events.json). In a motion without them, the
detectors of the benchmark find them (evaluation/detectors). `talkingeyes render MOTION --keys FILE` plays edited keys.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from talkingeyes.animation.event_keys import save_keys
from talkingeyes.core import rotation
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.motion import Blink, Events, Motion, Saccade
from talkingeyes.evaluation.detectors.blinks import detect_blinks
from talkingeyes.evaluation.detectors.saccades import detect_saccades
from talkingeyes.physiology import saccades as main_sequence
from talkingeyes.physiology.frame_saccades import find_saccades

MIN_DETECTOR_FPS = 60.0  # at lower rates, frames do not resolve a saccade


def write_keys(motion: Motion, path: Path, events: Events | None = None) -> None:
    """Write keys: `events` if they are known, otherwise detected events."""
    with atomic_write(path) as partial:
        save_keys(partial, detect_events(motion) if events is None else events, motion.fps)


def detect_events(motion: Motion) -> Events:
    """Detect saccades of gaze in space and blinks."""
    space = _pad_to_second(rotation.cyclopean_gaze(rotation.gaze_in_space(motion.head, motion.gaze)), motion.fps)
    valid = _pad_to_second(motion.valid, motion.fps)
    if motion.fps < MIN_DETECTOR_FPS:
        saccades = find_saccades(space, motion.fps)
    else:
        seen = detect_saccades(space, motion.fps, valid)
        saccades = tuple(
            Saccade(
                float(onset),
                float(offset - onset),
                _pair(start),
                _pair(start + step),
                float(main_sequence.skew(float(np.linalg.norm(step)))),
            )
            for onset, offset, start, step in zip(
                seen.onset_s, seen.offset_s, seen.start_rad, seen.displacement_rad, strict=True
            )
        )
    shut = detect_blinks(_pad_to_second(motion.lid, motion.fps), motion.fps, valid)
    blinks = tuple(
        Blink(float(on), max(float(peak - on), 1e-3), 0.0, max(float(off - peak), 1e-3), float(depth))
        for on, peak, off, depth in zip(shut.onset_s, shut.peak_s, shut.offset_s, shut.depth, strict=True)
    )
    return Events(saccades=saccades, blinks=blinks)


def _pad_to_second(values: Shaped[ndarray, "T ..."], fps: float) -> ndarray:
    """Repeat the last frame up to one second, the minimum for detectors."""
    missing = max(math.ceil(fps) + 1 - len(values), 0)
    held = np.concatenate([values, np.repeat(values[-1:], missing, axis=0)])
    return held if held.dtype == bool else held.astype(np.float64)


def _pair(angles: Float[ndarray, " 2"]) -> tuple[float, float]:
    return float(angles[0]), float(angles[1])
