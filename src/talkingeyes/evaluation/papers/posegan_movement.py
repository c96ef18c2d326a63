"""Motion metrics of generated poses: distances (Zhang et al., Table 2), jitter, seams, differences of clips, style.

Poses are in standard deviations of the train split, so that the six numbers have equal weight.

The style of a clip (`measure_style`; of the eyes, too, for models of one person) is: log standard deviations of
rotations and of their first and second differences. It grows with the length of a clip, so compare clips of similar
lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap

JITTER_HZ = 5.0
MIN_DEVIATION = 1e-4  # in standard deviations; floor for numbers that do not vary


@dataclass(frozen=True)
class Distances:
    """Root mean square difference of poses, and of motion per frame, over frames and numbers."""

    pose: float
    motion: float


def distances(made: Sequence[Float[ndarray, "T 6"]], true: Sequence[Float[ndarray, "T 6"]]) -> Distances:
    """Distances of eq. 3 over all clips together."""
    apart = [ours[: len(theirs)] - theirs[: len(ours)] for ours, theirs in zip(made, true, strict=True)]
    moved = [np.diff(each, axis=0) for each in apart]
    return Distances(_root_mean_square(apart), _root_mean_square(moved))


def jitter(poses: Sequence[Float[ndarray, "T P"]], fps: float) -> float:
    """Fraction of the power of velocity above 5 Hz, over numbers and clips; 0 for a still head."""
    above = total = 0.0
    for each in poses:
        velocity = np.diff(each, axis=0)
        power = np.abs(np.fft.rfft((velocity - velocity.mean(0)) * np.hanning(len(velocity))[:, None], axis=0)) ** 2
        hz = np.fft.rfftfreq(len(velocity), 1 / fps)
        above, total = above + power[hz > JITTER_HZ].sum(), total + power.sum()
    return float(above / total) if total > 0 else 0.0


def seam_speed_ratio(poses: Sequence[Float[ndarray, "T 6"]], window: int, shared: int) -> float:
    """Speed of steps into a new window relative to all other steps; NaN for motion of a single window.

    Windows have `window` frames, of which the first `shared` repeat the last ones of the window before.
    """
    joins = np.s_[window - 1 :: window - shared]
    speed = [np.linalg.norm(np.diff(each, axis=0), axis=1) for each in poses]
    at = np.concatenate([each[joins] for each in speed])
    elsewhere = np.concatenate([np.delete(each, joins) for each in speed])
    return float(at.mean() / max(elsewhere.mean(), 1e-12)) if len(at) else float("nan")


def clip_difference(poses: Sequence[Float[ndarray, "T 6"]]) -> float:
    """Mean root mean square difference of pairs of clips; 0 if a model ignores the speech."""
    frames = min(map(len, poses))
    pairs = [(i, j) for i in range(len(poses)) for j in range(i)]
    return float(np.mean([_root_mean_square([poses[i][:frames] - poses[j][:frames]]) for i, j in pairs]))


def measure_style(pose: Float[ndarray, "T P"]) -> Float[ndarray, " 3*P"]:
    """Style vector: log standard deviations of the numbers of a pose and of their first and second differences."""
    return np.asarray(
        np.log(np.concatenate([np.diff(pose, order, axis=0).std(0) for order in range(3)]).clip(min=MIN_DEVIATION))
    )


def style_distance(ours: Float[ndarray, " S"], theirs: Float[ndarray, " S"]) -> float:
    """Root mean square difference of two style vectors; 0.1 means about 10 % more or less."""
    return float(np.sqrt(np.mean((ours - theirs) ** 2)))


def _root_mean_square(arrays: Sequence[Float[ndarray, "T 6"]]) -> float:
    return float(np.sqrt(sum((each**2).sum() for each in arrays) / sum(each.size for each in arrays)))


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
