"""Resample a motion: saccades and blinks are rendered again from their events, the rest is interpolated.

The events are removed, the remainder is interpolated, and the events are rendered at the new times: a saccade that is
one step at 25 frames a second has the speed of the main sequence at 60 or 240, where interpolation would make it a slow
glide (the paper's second limitation).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.event_keys import EventKeys, edit_lids
from talkingeyes.animation.saccade_resampling import resample
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.physiology import blinks

FPS_BOUNDS = (10.0, 240.0)


def resample_motion(motion: Motion, events: Events, fps: float) -> Motion:
    """Resample a motion to `fps`; its duration stays."""
    if not FPS_BOUNDS[0] <= fps <= FPS_BOUNDS[1]:
        raise InputError(f"fps: should be {FPS_BOUNDS[0]:g} to {FPS_BOUNDS[1]:g}, got {fps:g}")
    if fps == motion.fps:
        return motion
    times = np.arange(len(motion)) / motion.fps
    new_times = np.arange(int(len(motion) * fps / motion.fps + 1e-9)) / fps
    space = rotation.gaze_in_space(motion.head, motion.gaze)
    resampled = resample(motion.head, space, events.saccades, motion.fps, fps)
    opened = edit_lids(motion.lid, EventKeys(Events(), Events(blinks=events.blinks)), times)
    shut = blinks.blink_closure(events.blinks, new_times)[:, None]
    lid = _between(opened, times, new_times)
    nearest = np.minimum(np.rint(new_times * motion.fps).astype(int), len(motion) - 1)
    return replace(
        motion,
        fps=fps,
        head=resampled.head,
        gaze=resampled.gaze,
        lid=np.where(shut > 0, lid + (1.0 - lid) * shut, lid),
        translation=_between(motion.translation, times, new_times),
        jaw=_between(motion.jaw, times, new_times),
        expression=_between(motion.expression, times, new_times),
        valid=motion.valid[nearest],
    )


def _between(
    values: Float[ndarray, "T C"], times: Float[ndarray, " T"], new_times: Float[ndarray, " N"]
) -> Float[ndarray, "N C"]:
    columns = [np.interp(new_times, times, column) for column in values.T]
    return np.stack(columns, axis=1) if columns else np.zeros((len(new_times), 0))
