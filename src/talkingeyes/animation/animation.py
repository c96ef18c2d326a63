"""An animation: a Motion and the events in it, rendered from a trajectory at any frame rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from talkingeyes.animation.event_keys import ShiftReason, save_keys
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.saccade_resampling import resample
from talkingeyes.core import rotation
from talkingeyes.core.motion import Blink, Events, Motion
from talkingeyes.physiology import blinks, eye_head


@dataclass(frozen=True)
class Animation:
    """A motion and the saccades and blinks in it; `reasons` tells why gaze shifts, a saccade each, if it is known."""

    motion: Motion
    events: Events
    reasons: tuple[ShiftReason, ...] = ()

    def save(self, path: Path | str) -> None:
        """Write the motion (.npz), and beside it the events as keys for editing (NAME.events.json)."""
        path = Path(path)
        self.motion.save(path)
        save_keys(path.with_name(f"{path.stem}.events.json"), self.events, self.motion.fps, self.reasons)


def render_trajectory(trajectory: GazeTrajectory, sampled_blinks: Sequence[Blink], fps: float) -> Animation:
    """Render a trajectory and its blinks at a frame rate; saccades follow the main sequence at any rate."""
    if fps == trajectory.fps:
        head, eye = trajectory.head, rotation.eye_in_head(trajectory.head, trajectory.gaze_in_space_rad)
    else:
        resampled = resample(trajectory.head, trajectory.gaze_in_space_rad, trajectory.saccades, trajectory.fps, fps)
        head, eye = resampled.head, resampled.gaze
    closure = blinks.blink_closure(sampled_blinks, np.arange(len(head)) / fps)
    eye = eye_head.clamp_to_eye_range(eye)  # gaze that is held over a blink stays in space while the head turns
    motion = Motion.of(fps, head, eye, lid=np.repeat(closure[:, None], 2, axis=1))
    return Animation(motion, Events(saccades=trajectory.saccades, blinks=tuple(sampled_blinks)))
