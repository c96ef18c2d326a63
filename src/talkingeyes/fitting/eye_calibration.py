"""Eye calibration of a clip: the gain of the pupil signal and the angle between the axes of the eyes.

Both are maximum a posteriori estimates per clip. The gain is the ratio of the detected pupil motion to the motion of
the head model's eyeball. It is below 1 for a pupil closer to the centre of rotation, and for a detector biased towards
the middle of the lids. Pupils alone do not determine the gain, but head motion does: between saccades the eyes
counter-rotate the head, so

    change of eye-in-head  =  - gain * change of head  +  noise        over `lag_s`, without the steps of saccades

is a regression whose slope is the gain. Half the difference of the eyes is kappa (the optical axis lies temporal of the
visual axis) minus half the vergence. The fitted value deviates from it because of detector bias and because of eye
centres that differ from the head model's. Both deviations are Gaussian, so the estimate is a variance-weighted mean of
prior and fitted value. A clip does not determine an error common to both eyes; it remains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.rotation import angles_to_gaze, direction_to_angles, gaze_to_angles, rotvec_to_direction
from talkingeyes.core.settings import Settings

Positive = Annotated[float, Field(gt=0)]
Spread = Annotated[float, Field(ge=0)]


class OculomotorRangeSettings(Settings):
    """Oculomotor range: largest eye-in-head rotation to either side, up and down, radians."""

    side_rad: Annotated[float, Field(gt=0, le=np.pi / 2)]
    up_rad: Annotated[float, Field(gt=0, le=np.pi / 2)]
    down_rad: Annotated[float, Field(gt=0, le=np.pi / 2)]


class EyeCalibrationSettings(Settings):
    """Priors of the calibration; a standard deviation of 0 fixes the parameter at its prior mean.

    `gain_yaw`, `gain_pitch`, `gain_sd`: prior of the gain. `lag_s`: lag of the regression. `saccade_rad`: change of
    gaze in space over the lag from which it counts as a saccade. `half_difference_rad`, `half_difference_sd_rad`: prior
    of half of left minus right, yaw. `pitch_difference_sd_rad`: the same for pitch, with mean 0. `vergence_sd_rad`:
    variation of the half difference within a clip. `noise_rad`: error of the fitted half difference.
    """

    gain_yaw: Positive
    gain_pitch: Positive
    gain_sd: Spread
    lag_s: Positive
    saccade_rad: Positive
    half_difference_rad: float
    half_difference_sd_rad: Positive
    pitch_difference_sd_rad: Positive
    vergence_sd_rad: Positive
    noise_rad: Spread


@dataclass(frozen=True)
class EyeCalibration:
    """Calibration of a clip in (yaw, pitch): gain, and half of left minus right (radians), measured and posterior.

    `shrinkage`: the fraction of its changes within the clip that is kept.
    """

    gain: Float[ndarray, " 2"]
    measured_rad: Float[ndarray, " 2"]
    posterior_rad: Float[ndarray, " 2"]
    shrinkage: float

    def apply(self, gaze: Float[ndarray, "T 2 3"], both: Bool[ndarray, " T"]) -> Float[ndarray, "T 2 3"]:
        """Correct fitted eye-in-head rotations, without torsion. `both`: frames in which both eyes are visible."""
        angles = gaze_to_angles(gaze) / self.gain
        half = (angles[:, 0] - angles[:, 1]) / 2
        change = np.where(both[:, None], (1.0 - self.shrinkage) * (half - self.measured_rad), 0.0)
        apart = self.posterior_rad - self.measured_rad - change
        return angles_to_gaze(angles + np.stack([apart, -apart], axis=1))


def eye_calibration(
    gaze: Float[ndarray, "T 2 3"],
    head: Float[ndarray, "T 3"],
    open_: Bool[ndarray, "T 2"],
    fps: float,
    settings: EyeCalibrationSettings,
) -> EyeCalibration:
    """Estimate the calibration from fitted eye-in-head and head rotations, and the frames in which eyes are open."""
    angles = gaze_to_angles(gaze)
    both = np.asarray(open_.all(axis=1))
    gain = _gain(angles.mean(axis=1), direction_to_angles(rotvec_to_direction(head)), both, fps, settings)
    prior = np.array([settings.half_difference_rad, 0.0])
    shrinkage = settings.vergence_sd_rad**2 / (settings.vergence_sd_rad**2 + settings.noise_rad**2)
    if not both.any():
        return EyeCalibration(gain, np.zeros(2), prior, shrinkage)
    half = np.median(angles[both, 0] - angles[both, 1], axis=0) / 2 / gain
    spread = np.array([settings.half_difference_sd_rad, settings.pitch_difference_sd_rad])
    believed = prior + spread**2 / (spread**2 + settings.noise_rad**2) * (half - prior)
    return EyeCalibration(gain, half, believed, shrinkage)


def _gain(
    eye_rad: Float[ndarray, "T 2"],
    head_rad: Float[ndarray, "T 2"],
    known: Bool[ndarray, " T"],
    fps: float,
    settings: EyeCalibrationSettings,
) -> Float[ndarray, " 2"]:
    """Regression slope of eye on head between saccades with a prior; three rounds, as saccades depend on the gain."""
    lag = max(1, round(settings.lag_s * fps))
    prior = np.array([settings.gain_yaw, settings.gain_pitch])
    gain = prior.copy()
    if len(known) <= lag or not settings.gain_sd:
        return gain
    eye, head = eye_rad[lag:] - eye_rad[:-lag], head_rad[lag:] - head_rad[:-lag]
    usable = known[lag:] & known[:-lag]
    for _ in range(3):
        still = usable & (np.linalg.norm(eye / gain + head, axis=1) < settings.saccade_rad)
        if still.sum() < 2 * lag:
            return gain
        noise = np.var(eye[still] + gain * head[still], axis=0)
        # changes over `lag` frames overlap, so samples are correlated
        weight = np.sum(head[still] ** 2, axis=0) / (noise * lag)
        slope = -np.sum(eye[still] * head[still], axis=0) / np.maximum(np.sum(head[still] ** 2, axis=0), 1e-12)
        gain = (prior / settings.gain_sd**2 + weight * slope) / (1.0 / settings.gain_sd**2 + weight)
        gain = np.clip(gain, 0.4, 1.6)
    return np.asarray(gain)


def limit_to_range(gaze: Float[ndarray, "*N 3"], limits: OculomotorRangeSettings) -> Float[ndarray, "*N 3"]:
    """Clamp gaze directions to the oculomotor range, as rotation vectors without torsion."""
    low = (-limits.side_rad, -limits.down_rad)
    return angles_to_gaze(np.clip(gaze_to_angles(gaze), low, (limits.side_rad, limits.up_rad)))
