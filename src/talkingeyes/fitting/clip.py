"""Fit one clip: face identity, head pose, LightGazeFit, blinks, gaze over blinks, smoothing (paper, III-B, III-C).

The head is fitted and smoothed first, because gaze is fitted relative to it and jitter of the head would move the eyes.
The paper holds the eye pose over a blink at the last open-eye state (smoothing `convolution`). By default, the last
open-eye gaze in space is held and the eyes counter-rotate the head (vestibulo-ocular reflex); otherwise each blink
during a head movement would end in a jump of gaze. If gaze differs after the blink, the shift is placed at the start of
the blink (`fixation_segmentation`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from jaxtyping import Bool
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import eye_in_head, gaze_in_space
from talkingeyes.core.settings import Settings
from talkingeyes.fitting.blink import BlinkSettings, EyelidMotion, expected_aspect_ratio, eye_aspect_ratio, fit_lids
from talkingeyes.fitting.expression import ExpressionSettings, fit_expression
from talkingeyes.fitting.eye_calibration import (
    EyeCalibrationSettings,
    OculomotorRangeSettings,
    eye_calibration,
    limit_to_range,
)
from talkingeyes.fitting.face_identity import FaceIdentity, FaceIdentitySettings, face_identity
from talkingeyes.fitting.gaps import interpolate_gaps, runs
from talkingeyes.fitting.head_pose import HeadPose, HeadPoseSettings, head_pose
from talkingeyes.fitting.lightgazefit import LightGazeFitSettings, PupilObservations, Solution, fit_gaze
from talkingeyes.fitting.smoothing import ConvolutionSettings, SmoothingSettings, convolve_motion, smooth_gaze
from talkingeyes.head.observation import Observation

Share = Annotated[float, Field(ge=0, le=1)]


class RejectSettings(Settings):
    """Criteria for rejecting a clip as training data; `max_gap_s`: longest gap in which held gaze stays valid."""

    min_duration_s: Annotated[float, Field(ge=0)]
    hidden_face: Annotated[float, Field(ge=0, lt=1)]
    hidden_gaze: Share
    residual_px: Annotated[float, Field(gt=0)]
    head_yaw_rad: Annotated[float, Field(gt=0)]
    max_gap_s: Annotated[float, Field(gt=0)]


class MethodComparisonSettings(Settings):
    """Settings of the comparison of solvers: the number of clips, spread over the corpus, also fitted with Adam."""

    adam_clips: Annotated[int, Field(ge=0)]


class FitSettings(Settings):
    """The configuration section `fit`."""

    face_identity: FaceIdentitySettings
    head_pose: HeadPoseSettings
    lightgazefit: LightGazeFitSettings
    eye_calibration: EyeCalibrationSettings
    oculomotor_range: OculomotorRangeSettings
    face: ExpressionSettings
    blink: BlinkSettings
    smoothing: SmoothingSettings
    reject: RejectSettings
    method_comparison: MethodComparisonSettings


@dataclass(frozen=True)
class FitResult:
    """Fit of one clip: motion, intermediate results, and the reason for rejection (empty if accepted)."""

    motion: Motion
    per_frame: Motion
    face_identity: FaceIdentity
    pose: HeadPose
    lids: EyelidMotion
    solution: Solution
    reject_reason: str


def fit_clip(observation: Observation, settings: FitSettings) -> FitResult:
    """Fit the motion of one clip to its landmarks and pupils."""
    camera = observation.camera
    who = face_identity(observation.landmarks, camera, settings.head_pose, settings.face_identity)
    pose = head_pose(observation.landmarks, camera, settings.head_pose, who.face)
    observations = PupilObservations(observation.pupils, pose.head, pose.translation, camera)
    solution = fit_gaze(observations, settings.lightgazefit)
    seen = observations.seen & pose.seen[:, None]
    visible = seen.any(axis=1)
    gaze = interpolate_gaps(solution.gaze.reshape(-1, 6), visible).reshape(-1, 2, 3)
    raw = Motion.of(observation.fps, pose.head, gaze, translation=pose.translation)
    shut, wide = (expected_aspect_ratio(raw, camera, closure) for closure in (1.0, 0.0))
    eyelids = fit_lids(eye_aspect_ratio(observation.landmarks) - shut, wide - shut, raw.fps, settings.blink)
    open_ = visible & ~eyelids.blinking
    shown_eyes = seen & open_[:, None]
    clip_eyes = eye_calibration(gaze, raw.head, shown_eyes, raw.fps, settings.eye_calibration)
    gaze = clip_eyes.apply(gaze, np.asarray(shown_eyes.all(axis=1)))
    shown = fit_expression(observation.landmarks, pose, who.face, camera, settings.face)
    motion = replace(
        raw,
        gaze=gaze,
        lid=eyelids.lid,
        jaw=shown.jaw,
        expression=shown.expression,
        expression_names=shown.names,
        valid=pose.seen & ~_long_gaps(open_, settings.reject.max_gap_s * raw.fps),
    )
    motion = _smoothed(motion, shown_eyes, settings)
    return FitResult(
        motion,
        raw,
        who,
        pose,
        eyelids,
        solution,
        rejection_reason(motion, pose, visible | eyelids.blinking, settings.reject),
    )


def _smoothed(motion: Motion, seen: Bool[ndarray, "T 2"], settings: FitSettings) -> Motion:
    """The motion with smoothed gaze, within the range of the eyes; the paper's convolution smooths head and face as
    well."""
    if isinstance(settings.smoothing, ConvolutionSettings):
        motion = convolve_motion(motion, seen, settings.smoothing)
        gaze = motion.gaze
    else:
        space = smooth_gaze(gaze_in_space(motion.head, motion.gaze), seen, motion.fps, settings.smoothing)
        gaze = eye_in_head(motion.head, space)
    return replace(motion, gaze=limit_to_range(gaze, settings.oculomotor_range))


def rejection_reason(motion: Motion, pose: HeadPose, known: Bool[ndarray, " T"], settings: RejectSettings) -> str:
    """Reason to exclude a clip from training, or "". A turned head hides an eye (paper, III-B)."""
    if motion.seconds < settings.min_duration_s:
        return f"shorter than {settings.min_duration_s:g} s: {motion.seconds:.2f} s"
    hidden_face, hidden_gaze = float(np.mean(~pose.seen)), float(np.mean(~known))
    if hidden_face > settings.hidden_face:
        return f"face hidden in more than {settings.hidden_face:.0%} of frames: {hidden_face:.0%}"
    if hidden_gaze > settings.hidden_gaze:
        return f"both pupils hidden in more than {settings.hidden_gaze:.0%} of frames: {hidden_gaze:.0%}"
    residual_px = float(np.nanmedian(pose.residual_px))
    if residual_px > settings.residual_px:
        return f"face does not fit, median residual above {settings.residual_px:g} px: {residual_px:.2f} px"
    head_yaw_rad = float(np.median(np.abs(motion.head[:, 1])))
    if head_yaw_rad > settings.head_yaw_rad:
        return f"head turned by more than {settings.head_yaw_rad:g} rad (median): {head_yaw_rad:.2f} rad"
    return ""


def _long_gaps(open_: Bool[ndarray, " T"], longest: float) -> Bool[ndarray, " T"]:
    flags = np.zeros(len(open_), bool)
    for start, stop in runs(~open_):
        flags[start:stop] = stop - start > longest
    return flags
