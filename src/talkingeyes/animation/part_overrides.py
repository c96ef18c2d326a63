"""The parts of an animation: each is generated, taken from another motion, or switched off.

    head     off: faces straight ahead; gaze in space stays, within the range of the eyes
    gaze     off: the eyes look straight ahead in the head; there are no saccades
    blinks   off: none; lids still follow gaze, and an emotion still opens or closes them
    face     off: jaw and expression are at rest, lids are not affected by emotion

A replaced part is taken unchanged from a motion that lasts as long as the speech: a head moves under the generated gaze
in space, eyes keep their angles in the head, blinks are the whole `lid`. The events describe the result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from talkingeyes.animation.motion_resampling import resample_motion
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.physiology import eye_head
from talkingeyes.physiology.frame_saccades import find_saccades

PARTS = ("head", "gaze", "blinks", "face")


@dataclass(frozen=True)
class PartOverrides:
    """The parts that are switched off, and those that are taken from other motions."""

    disabled: tuple[str, ...] = ()
    replacements: Mapping[str, Motion] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raises InputError (one line) for an unknown part, or one that is both replaced and switched off."""
        for name in (*self.disabled, *self.replacements):
            if name not in PARTS:
                raise InputError(f"parts: should be among {', '.join(PARTS)}, got {name}")
        both = [name for name in self.disabled if name in self.replacements]
        if both:
            raise InputError(f"parts: {both[0]} should be replaced or switched off, got both")

    def is_generated(self, part: str) -> bool:
        """Whether a part is generated."""
        return part not in self.disabled and part not in self.replacements


NO_OVERRIDES = PartOverrides()


def override_motion(motion: Motion, parts: PartOverrides) -> Motion:
    """Replace or switch off parts of a motion; blinks that are switched off were not sampled in the first place.

    Raises InputError (one line) for a motion that is shorter than the speech.
    """
    sources = {name: _resample_source(name, source, motion) for name, source in parts.replacements.items()}
    if "face" in sources:
        face = sources["face"]
        motion = replace(
            motion,
            jaw=face.jaw,
            expression=face.expression,
            expression_names=face.expression_names,
            head_model=face.head_model,
        )
    elif "face" in parts.disabled:
        frames = len(motion)
        motion = replace(motion, jaw=np.zeros((frames, 3)), expression=np.zeros((frames, 0)), expression_names=())
    if "blinks" in sources:
        motion = replace(motion, lid=sources["blinks"].lid)
    if "head" in sources or "head" in parts.disabled:
        head = sources["head"].head if "head" in sources else np.zeros((len(motion), 3))
        moved = sources["head"].translation if "head" in sources else np.zeros((len(motion), 3))
        space = rotation.gaze_in_space(motion.head, motion.gaze)
        motion = replace(
            motion, head=head, translation=moved, gaze=eye_head.clamp_to_eye_range(rotation.eye_in_head(head, space))
        )
    if "gaze" in sources or "gaze" in parts.disabled:
        gaze = sources["gaze"].gaze if "gaze" in sources else np.zeros((len(motion), 2, 3))
        motion = replace(motion, gaze=gaze)
    return motion


def override_events(events: Events, motion: Motion, parts: PartOverrides) -> Events:
    """The events in a motion after `override_motion`; saccades of replaced eyes are detected."""
    if "gaze" in parts.disabled:
        events = replace(events, saccades=())
    elif "gaze" in parts.replacements:
        space = rotation.gaze_in_space(motion.head, motion.gaze).mean(axis=1)
        events = replace(events, saccades=find_saccades(space, motion.fps))
    if not parts.is_generated("blinks"):
        events = replace(events, blinks=())
    return events


def _resample_source(name: str, source: Motion, motion: Motion) -> Motion:
    """The source of a part at the frame rate and the length of the animation."""
    space = rotation.gaze_in_space(source.head, source.gaze).mean(axis=1)
    same = resample_motion(source, Events(saccades=find_saccades(space, source.fps)), motion.fps)
    if len(same) < len(motion):
        raise InputError(
            f"replace {name}: should last as long as the speech, {motion.seconds:.2f} s, got {source.seconds:.2f} s"
        )
    return same.cut(0, len(motion))
