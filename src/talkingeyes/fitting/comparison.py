"""Evaluation of the fit of one clip: Table VIII by method, head error, blink detection.

Methods: `lightgazefit`, the whole fit with the configured solver; `per_frame`, the same without held gaze and
smoothing; on some clips `lightgazefit_adam`, the whole fit with Adam, and `lightgazefit_same_clips`, the configured
solver on the same clips; `ground_truth`, if known. The results are small enough to be pooled over a corpus.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core.motion import Events, Motion
from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.fitting.accuracy import ErrorSums, FitReference
from talkingeyes.fitting.clip import FitResult, FitSettings, fit_clip
from talkingeyes.head.observation import Observation


@dataclass(frozen=True)
class GroundTruth:
    """True motion and events of a clip."""

    motion: Motion
    events: Events


@dataclass(frozen=True)
class BlinkMatches:
    """Counts of detected and true blinks, and of those that overlap a blink of the other kind."""

    found: int = 0
    matched_detections: int = 0
    true: int = 0
    matched_truth: int = 0

    def __add__(self, other: BlinkMatches) -> BlinkMatches:
        return BlinkMatches(
            self.found + other.found,
            self.matched_detections + other.matched_detections,
            self.true + other.true,
            self.matched_truth + other.matched_truth,
        )

    @property
    def precision(self) -> float:
        """Fraction of detected blinks that are true."""
        return self.matched_detections / max(self.found, 1)

    @property
    def recall(self) -> float:
        """Fraction of true blinks that are detected."""
        return self.matched_truth / max(self.true, 1)


@dataclass(frozen=True)
class FitEvaluation:
    """Evaluation of one clip. Head errors (radians, metres) and blink matches are None if the truth is unknown."""

    error_sums_by_method: dict[str, ErrorSums]
    objectives: dict[str, float] = field(default_factory=dict)
    residual_px: float = 0.0
    head_error_rad: float | None = None
    translation_error_m: float | None = None
    match: BlinkMatches | None = None


def evaluate_fit(
    observation: Observation, fit: FitResult, truth: GroundTruth | None, settings: FitSettings, by_adam: bool
) -> FitEvaluation:
    """Compare the methods on one clip; `by_adam` also runs the paper's solver, which takes seconds."""
    blinking = fit.lids.blinking if truth is None else blink_frames(truth.events, len(fit.motion), fit.motion.fps)
    reference = FitReference(
        pupils=observation.pupils,
        camera=observation.camera,
        frame_mask=~blinking & fit.pose.seen,
        pose=fit.motion if truth is None else truth.motion,
        truth=None if truth is None else truth.motion,
    )
    methods = {"lightgazefit": fit.motion, "per_frame": fit.per_frame}
    objectives = {"lightgazefit": float(fit.solution.objective.mean())}
    if truth is not None:
        methods["ground_truth"] = truth.motion
    if by_adam:
        other = fit_clip(observation, with_adam(settings))
        methods |= {"lightgazefit_adam": other.motion, "lightgazefit_same_clips": fit.motion}
        objectives |= {
            "lightgazefit_adam": float(other.solution.objective.mean()),
            "lightgazefit_same_clips": objectives["lightgazefit"],
        }
    seen = fit.pose.seen
    return FitEvaluation(
        error_sums_by_method={name: reference.error_sums(motion) for name, motion in methods.items()},
        objectives=objectives,
        residual_px=float(np.median(fit.pose.residual_px[seen])) if seen.any() else 0.0,
        head_error_rad=None if truth is None else float(head_error(fit.motion, truth.motion)[seen].mean()),
        translation_error_m=None if truth is None else float(_moved(fit.motion, truth.motion)[seen].mean()),
        match=None if truth is None else match_blinks(fit.lids.blinks, truth.events, fit.motion.fps),
    )


def with_adam(settings: FitSettings) -> FitSettings:
    """Copy the settings with the paper's solver."""
    return settings.model_copy(update={"lightgazefit": settings.lightgazefit.with_adam()})


def blink_frames(events: Events, frames: int, fps: float) -> Bool[ndarray, " T"]:
    """Frames inside true blinks, from onset to end."""
    flags = np.zeros(frames, bool)
    for start, stop in blink_spans(events, fps):
        flags[max(start, 0) : stop] = True
    return flags


def blink_spans(events: Events, fps: float) -> list[tuple[int, int]]:
    """(start, stop) frames of true blinks."""
    return [
        (int(np.floor(b.onset_s * fps)), int(np.ceil((b.onset_s + b.closing_s + b.hold_s + b.opening_s) * fps)) + 1)
        for b in events.blinks
    ]


def match_blinks(found: tuple[tuple[int, int], ...], events: Events, fps: float) -> BlinkMatches:
    """Match detected with true blinks; two blinks match if they overlap."""
    spans = blink_spans(events, fps)
    overlaps = np.array([[a[0] < b[1] and b[0] < a[1] for b in spans] for a in found], bool)
    overlaps = overlaps.reshape(len(found), len(spans))
    return BlinkMatches(len(found), int(overlaps.any(axis=1).sum()), len(spans), int(overlaps.any(axis=0).sum()))


def head_error(fitted: Motion, truth: Motion) -> Float[ndarray, " T"]:
    """Angle between fitted and true head rotation, radians."""
    trace = np.einsum("tij,tij->t", rotvec_to_matrix(fitted.head), rotvec_to_matrix(truth.head))
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0)))


def _moved(fitted: Motion, truth: Motion) -> Float[ndarray, " T"]:
    return np.asarray(np.linalg.norm(fitted.translation - truth.translation, axis=-1))
