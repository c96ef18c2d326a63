"""The parts of a performance: each comes from its model, from another motion, or is switched off.

    head     off: it faces straight ahead; gaze in space stays where it is, as far as eyes turn
    gaze     off: the eyes look straight ahead in the head; there are no saccades
    blinks   off: there are none; lids still follow gaze, and an emotion still opens or closes them
    face     off: jaw and expression are at rest, lids know no emotion

A part that is replaced is taken as it is from a motion that lasts as long as the speech: a head moves under the same
gaze in space, eyes keep their angles in the head, blinks are the whole `lid`. Events tell what is left of the model's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from talkingeyes.animation.retime import retimed
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.physiology import eye_head
from talkingeyes.physiology.steps import find_saccades

PARTS = ("head", "gaze", "blinks", "face")


@dataclass(frozen=True)
class Parts:
    """Which parts are switched off, and which are taken from other motions."""

    without: tuple[str, ...] = ()
    replaced: Mapping[str, Motion] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raises InputError (one line) for a part that there is not, or that is both replaced and switched off."""
        for name in (*self.without, *self.replaced):
            if name not in PARTS:
                raise InputError(f"parts: should be among {', '.join(PARTS)}, got {name}")
        both = [name for name in self.without if name in self.replaced]
        if both:
            raise InputError(f"parts: {both[0]} should be replaced or switched off, got both")

    @property
    def models_own(self) -> bool:
        """Whether all parts are the models'."""
        return not self.without and not self.replaced

    def models_give(self, part: str) -> bool:
        """Whether a part is a model's."""
        return part not in self.without and part not in self.replaced


AS_MODELLED = Parts()


def recast_motion(motion: Motion, parts: Parts) -> Motion:
    """The motion with its parts replaced or switched off, but for blinks that are switched off: those are not drawn.

    Raises InputError (one line) for a motion that is shorter than the speech.
    """
    donors = {name: _fitted(name, donor, motion) for name, donor in parts.replaced.items()}
    if "face" in donors:
        face = donors["face"]
        motion = replace(
            motion,
            jaw=face.jaw,
            expression=face.expression,
            expression_names=face.expression_names,
            head_model=face.head_model,
        )
    elif "face" in parts.without:
        frames = len(motion)
        motion = replace(motion, jaw=np.zeros((frames, 3)), expression=np.zeros((frames, 0)), expression_names=())
    if "blinks" in donors:
        motion = replace(motion, lid=donors["blinks"].lid)
    if "head" in donors or "head" in parts.without:
        head = donors["head"].head if "head" in donors else np.zeros((len(motion), 3))
        moved = donors["head"].translation if "head" in donors else np.zeros((len(motion), 3))
        space = rotation.gaze_in_space(motion.head, motion.gaze)
        motion = replace(
            motion, head=head, translation=moved, gaze=eye_head.within_range(rotation.eye_in_head(head, space))
        )
    if "gaze" in donors or "gaze" in parts.without:
        gaze = donors["gaze"].gaze if "gaze" in donors else np.zeros((len(motion), 2, 3))
        motion = replace(motion, gaze=gaze)
    return motion


def recast_events(events: Events, motion: Motion, parts: Parts) -> Events:
    """The events that a recast motion still shows: saccades are found anew where the eyes are another's."""
    if "gaze" in parts.without:
        events = replace(events, saccades=())
    elif "gaze" in parts.replaced:
        space = rotation.gaze_in_space(motion.head, motion.gaze).mean(axis=1)
        events = replace(events, saccades=find_saccades(space, motion.fps))
    if not parts.models_give("blinks"):
        events = replace(events, blinks=())
    return events


def _fitted(name: str, donor: Motion, motion: Motion) -> Motion:
    """A motion at the frame rate and the length of the performance."""
    space = rotation.gaze_in_space(donor.head, donor.gaze).mean(axis=1)
    same = retimed(donor, Events(saccades=find_saccades(space, donor.fps)), motion.fps)
    if len(same) < len(motion):
        raise InputError(
            f"replace {name}: should last as long as the speech, {motion.seconds:.2f} s, got {donor.seconds:.2f} s"
        )
    return same.cut(0, len(motion))
