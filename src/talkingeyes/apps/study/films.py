"""Films of a study: the motion of each condition as the design defines it, with the clip's sound.

A film takes the varied parts from its condition and the shared ones from the truth; other parts are at rest. Faults of
the attention check are an upside-down picture, or sound that is late by more than a second.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.apps.study.design import Design
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES
from talkingeyes.head.model import HeadModel
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.video import write_video
from talkingeyes.rendering.view import OrbitCamera

SOUND_DELAY_S = 1.2


@dataclass(frozen=True)
class FilmContent:
    """Content of one film."""

    motion: Motion
    sound: Float[ndarray, " N"]
    static_lids: bool = False
    fault: str | None = None


def film_motion(design: Design, motion: Motion, truth: Motion | None) -> Motion:
    """Motion of a condition for its films. Raises InputError if its frame rate differs from the truth's."""
    if truth is not None and truth.fps != motion.fps:
        raise InputError(f"motion: should have the frame rate of the truth, {truth.fps:g} fps, got {motion.fps:g}")
    frames = len(motion) if truth is None else min(len(motion), len(truth))
    source = motion.cut(0, frames)
    parts: dict[str, Any] = {"translation": np.zeros((frames, 3))}
    parts |= _parts(source, design.varied_parts)
    if truth is not None:
        parts |= _parts(truth.cut(0, frames), design.shared_parts)
    head, gaze = (parts.pop(name, np.zeros(shape)) for name, shape in (("head", (frames, 3)), ("gaze", (frames, 2, 3))))
    return Motion.of(motion.fps, head, gaze, **parts)


def _parts(motion: Motion, names: tuple[str, ...]) -> dict[str, Any]:
    found = {name: getattr(motion, name) for name in names}
    if "expression" in names:
        found |= {"expression_names": motion.expression_names, "head_model": motion.head_model}
    return found


def trimmed(content: FilmContent, seconds: float | None) -> FilmContent:
    """The first seconds of a film; None: the whole film."""
    if seconds is None:
        return content
    motion = content.motion.cut(0, round(seconds * content.motion.fps))
    return replace(content, motion=motion, sound=content.sound[: round(seconds * SAMPLE_RATE)])


def static_lids(head: HeadModel) -> HeadModel:
    """A head with lids that blink but do not follow gaze: the gaze shapes of the Eyelid model are set to zero."""
    expression = head.expression.copy()
    for name in LID_SHAPES:
        if "Blink" not in name:
            expression[head.shape(name)] = 0.0
    return replace(head, expression=expression)


def write_film(content: FilmContent, head: HeadModel, view: OrbitCamera, path: Path) -> None:
    """Render and write one film."""
    renderer = HeadRenderer(static_lids(head) if content.static_lids else head, view)
    sound = _late(content.sound) if content.fault == "late_sound" else content.sound
    write_video(path, _pictures(renderer, content), content.motion.fps, sound)


def reencode_film(source: Path, seconds: float | None, fault: str | None, path: Path) -> None:
    """Trim an external film, and add the fault."""
    import av

    with av.open(str(source)) as container:
        fps = float(container.streams.video[0].average_rate or 25)
    sound = read_speech(source)
    most = math.inf if seconds is None else round(seconds * fps)
    frames = itertools.takewhile(lambda each: each[0] < most, enumerate(_decoded(source)))
    pictures = (image[::-1] if fault == "upside_down" else image for _, image in frames)
    write_video(path, pictures, fps, _late(sound) if fault == "late_sound" else sound)


def _decoded(source: Path) -> Iterator[UInt8[ndarray, "H W 3"]]:
    import av

    with av.open(str(source)) as container:
        for frame in container.decode(video=0):
            yield frame.to_ndarray(format="rgb24")


def _late(sound: Float[ndarray, " N"]) -> Float[ndarray, " M"]:
    return np.concatenate([np.zeros(round(SOUND_DELAY_S * SAMPLE_RATE), sound.dtype), sound])


def _pictures(renderer: HeadRenderer, content: FilmContent) -> Iterator[UInt8[ndarray, "H W 3"]]:
    for image in renderer.draw(to_forward_axes(content.motion)):
        yield image[::-1] if content.fault == "upside_down" else image
