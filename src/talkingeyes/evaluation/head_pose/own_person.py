"""How a person moves, in the recording and by models: style of head and eyes over clips, with intervals over clips.

The style of a clip is movement.measure_style: log standard deviations of rotations and of their first and second
differences. It grows with the length of a clip, so compare clips of similar lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap
from talkingeyes.evaluation.head_pose.movement import measure_style

PARTS = ("head", "eyes")


@dataclass(frozen=True)
class ClipStyle:
    """Style vectors of one clip: of the head's rotation vector and of yaw and pitch of the eyes in the head."""

    head: Float[ndarray, " 9"]
    eyes: Float[ndarray, " 6"]

    @classmethod
    def of(cls, head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"]) -> ClipStyle:
        """Mean over the samples S of one clip; radians."""
        eyes = gaze_to_angles(gaze).mean(axis=-2)
        return cls(*(np.mean([measure_style(each) for each in part], axis=0) for part in (head, eyes)))


@dataclass(frozen=True)
class StyleComparison:
    """Style of one part beside the person's own: root mean square difference (0.1 is about 10 %), and the geometric
    means of the ratios of range and of speed."""

    distance: Estimate
    range: Estimate
    speed: Estimate


def compare_styles(
    ours: Sequence[ClipStyle], person: Sequence[ClipStyle], settings: BootstrapSettings, *, same_clips: bool
) -> dict[str, StyleComparison]:
    """By part: the mean style of clips compared with that of the person's left-out clips.

    `same_clips`: whether `ours` are motions for the sounds of these clips, which are then resampled together.
    """
    found = {}
    for part in PARTS:
        own, true = (np.stack([getattr(each, part) for each in clips]) for clips in (ours, person))
        found[part] = _compare(own, true, settings, same_clips)
    return found


def _compare(
    own: Float[ndarray, "N S"], true: Float[ndarray, "M S"], settings: BootstrapSettings, same_clips: bool
) -> StyleComparison:
    def estimate(statistic: Callable[[Float[ndarray, "3 P"]], float]) -> Estimate:
        """A statistic of the log ratios: a row each for the numbers and their first and second differences."""

        def of_clips(clips: ndarray) -> float:
            ratios = own[clips if same_clips else slice(None)].mean(0) - true[clips].mean(0)
            return statistic(ratios.reshape(3, -1))

        return bootstrap(of_clips, len(true), settings)

    return StyleComparison(
        estimate(lambda ratios: float(np.sqrt(np.mean(ratios**2)))),
        estimate(lambda ratios: float(np.exp(ratios[0].mean()))),
        estimate(lambda ratios: float(np.exp(ratios[1].mean()))),
    )
