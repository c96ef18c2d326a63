"""Motions for tests of formats: smooth, with all fields, main sequence saccades and blinks."""

from __future__ import annotations

import numpy as np

from talkingeyes.core import rotation
from talkingeyes.core.motion import Blink, Events, Motion, Saccade
from talkingeyes.formats import arkit
from talkingeyes.physiology import blinks, saccades

SACCADES_DEG = ((0.5, (12.0, 0.0)), (1.1, (-6.0, 4.0)), (1.7, (3.0, -8.0)), (2.4, (0.0, 0.0)))
BLINKS = (Blink(0.8, 0.09, 0.03, 0.2, 1.0), Blink(2.0, 0.08, 0.02, 0.2, 1.0))


def events() -> Events:
    """A chain of saccades, and two blinks."""
    chain: list[Saccade] = []
    at = (0.0, 0.0)
    for onset, target in SACCADES_DEG:
        end = (float(np.radians(target[0])), float(np.radians(target[1])))
        size = float(np.hypot(end[0] - at[0], end[1] - at[1]))
        chain.append(Saccade(onset, float(saccades.duration_s(size)), at, end, float(saccades.skew(size))))
        at = end
    return Events(saccades=tuple(chain), blinks=BLINKS)


def motion(fps: float = 25.0, seconds: float = 3.0) -> Motion:
    """The events, a swaying head, lines of sight converged by 4 degrees, all face coefficients between 0 and 0.4."""
    times = np.arange(round(seconds * fps)) / fps
    waves = np.sin(2 * np.pi * times[:, None] * [0.31, 0.47, 0.23] + [0.2, 1.0, 2.0])
    head = waves * np.radians([3.0, 6.0, 2.0])
    space = np.repeat(saccades.gaze_path(events().saccades, (0.0, 0.0), times)[:, None], 2, axis=1)
    space[..., 0] += np.radians([2.5, -2.5])  # optical axes, 4.5 degrees aside of the lines of sight
    shut = blinks.blink_closure(BLINKS, times)[:, None]
    lid = np.repeat(-0.05 + 1.05 * shut, 2, axis=1)
    expression = 0.2 + 0.2 * np.sin(times[:, None] * np.linspace(1, 5, len(arkit.EXPRESSION)))
    expression[:, ["eyeWide" in name for name in arkit.EXPRESSION]] = 0.0
    return Motion.of(
        fps,
        head,
        rotation.eye_in_head(head, space),
        translation=0.01 * waves,
        lid=lid,
        jaw=np.stack([0.15 + 0.1 * waves[:, 0], 0.05 * waves[:, 1], np.zeros(len(times))], axis=1),
        expression=expression,
        expression_names=arkit.EXPRESSION,
    )


def flame_motion(fps: float = 25.0) -> Motion:
    """The same with an expression of FLAME."""
    made = motion(fps)
    weights = np.sin(np.arange(len(made))[:, None] / 9 + np.arange(100))
    return Motion.of(
        fps,
        made.head,
        made.gaze,
        translation=made.translation,
        lid=made.lid,
        jaw=made.jaw,
        expression=weights,
        expression_names=tuple(f"expression_{number:03d}" for number in range(100)),
        head_model="flame",
    )
