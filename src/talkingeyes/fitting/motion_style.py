"""Motion style of a person: mean and spread of head and gaze, saccade rate, blink rate.

`fit` measures the style of every speaker (speakers.json), a model stores them, and `animation.style_transfer` applies
them to generated motion. Head: rotation vectors; gaze: (yaw, pitch) in space; radians.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import TypeAdapter

from talkingeyes.core import rotation
from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.physiology.frame_saccades import find_saccades

SPEAKERS_FILE = "speakers.json"
MIN_CLIP_S = 1.0
BLINK_CLOSURE, MAX_BLINK_S = 0.35, 0.8


@dataclass(frozen=True)
class MotionStyle:
    """Means, standard deviations within a clip, and rates per minute."""

    head_mean_rad: tuple[float, float, float]
    head_sd_rad: tuple[float, float, float]
    gaze_mean_rad: tuple[float, float]
    gaze_sd_rad: tuple[float, float]
    saccades_per_min: float
    blinks_per_min: float


def measure_style(motion: Motion) -> MotionStyle:
    """Measure the style of one clip, with saccades found by physiology.frame_saccades.

    Raises InputError if the clip is shorter than MIN_CLIP_S.
    """
    if motion.seconds < MIN_CLIP_S:
        raise InputError(f"style: a clip should last at least {MIN_CLIP_S:g} s, got {motion.seconds:.2f} s")
    space = rotation.gaze_in_space(motion.head, motion.gaze)
    found = find_saccades(space.mean(axis=1), motion.fps)
    return MotionStyle(
        head_mean_rad=_triple(motion.head.mean(axis=0)),
        head_sd_rad=_triple(motion.head.std(axis=0)),
        gaze_mean_rad=_pair(space.mean(axis=(0, 1))),
        gaze_sd_rad=_pair(space.mean(axis=1).std(axis=0)),
        saccades_per_min=60.0 * len(found) / motion.seconds,
        blinks_per_min=60.0 * _blinks(motion) / motion.seconds,
    )


def _blinks(motion: Motion) -> int:
    """Count the blinks: closures of `BLINK_CLOSURE` beyond the median lid, of at most MAX_BLINK_S."""
    lid = motion.lid.mean(axis=1)
    shut = lid - np.median(lid) >= BLINK_CLOSURE
    edges = np.flatnonzero(np.diff(np.concatenate([[0], shut, [0]])))
    return int((edges[1::2] - edges[::2] <= MAX_BLINK_S * motion.fps).sum())


def mean_style(styles: Sequence[MotionStyle], seconds: Sequence[float]) -> MotionStyle:
    """Style of a person over clips, weighted by duration."""
    weight = np.asarray(seconds) / np.sum(seconds)
    mean = {name: weight @ np.array([getattr(each, name) for each in styles]) for name in asdict(styles[0])}
    return MotionStyle(
        _triple(mean["head_mean_rad"]),
        _triple(mean["head_sd_rad"]),
        _pair(mean["gaze_mean_rad"]),
        _pair(mean["gaze_sd_rad"]),
        float(mean["saccades_per_min"]),
        float(mean["blinks_per_min"]),
    )


def save_speakers(path: Path, speakers: Mapping[str, MotionStyle]) -> None:
    """Write the styles of speakers, by name, as JSON."""
    path.write_text(
        json.dumps({name: asdict(motion_style) for name, motion_style in sorted(speakers.items())}, indent=1)
    )


def load_speakers(path: Path) -> dict[str, MotionStyle]:
    """Read the styles of speakers of a model. Raises InputError if the file is missing or damaged."""
    content = read_json(path, "file of speakers' styles")
    try:
        return {name: TypeAdapter(MotionStyle).validate_python(values) for name, values in content.items()}
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: should hold styles of speakers, got {error!r}") from None


def _triple(values: Float[ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = (float(each) for each in values)
    return x, y, z


def _pair(values: Float[ndarray, " 2"]) -> tuple[float, float]:
    yaw, pitch = (float(each) for each in values)
    return yaw, pitch
