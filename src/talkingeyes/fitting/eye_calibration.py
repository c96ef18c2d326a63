"""What one clip says of its eyes: how far a pupil moves with a turn, and how the eyes' axes stand to each other.

Two unknowns a clip with priors, by maximum a posteriori. The gain is how far the detected pupil follows the eye, as a
share of what the head's eyeball would show: a pupil that lies less deep, and a detector drawn to the middle of the
lids, move less. Pupils alone do not tell it, but heads do: between saccades the eyes counter-rotate the head, so

    change of eye-in-head  =  - gain * change of head  +  noise        over `lag_s`, without the steps of saccades

is a regression whose slope is the gain. The half difference of the eyes is kappa (the optical axis stands to the temple
of the visual one) less half the vergence, and differs from what was fitted by the detector's bias and by eyes that do
not stand where the head has them; both are Gaussian, so the estimate lies between the two by their variances. What both
eyes have in common is not told by anything in the clip and stays.
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
    """How far an eye turns in its head, radians: to either side, up and down."""

    side_rad: Annotated[float, Field(gt=0, le=np.pi / 2)]
    up_rad: Annotated[float, Field(gt=0, le=np.pi / 2)]
    down_rad: Annotated[float, Field(gt=0, le=np.pi / 2)]


class EyeCalibrationSettings(Settings):
    """Priors of the unknowns; a spread of 0 leaves the prior's mean, whatever the clip says.

    `gain_yaw`, `gain_pitch`, `gain_sd`: of the gain; `lag_s`, `saccade_rad`: of the regression, and the change of gaze
    in space from which it is a saccade. `half_difference_rad`, `half_difference_sd_rad`: half of left minus right, yaw;
    `pitch_difference_sd_rad`: pitch, about 0; `vergence_sd_rad`: how it changes within a clip; `noise_rad`: of what is
    fitted of it.
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
    """Of a clip, (yaw, pitch): gain; half of left minus right, radians, as pupils have it and as it is believed.

    `shrinkage`: how much of its changes is believed.
    """

    gain: Float[ndarray, " 2"]
    measured_rad: Float[ndarray, " 2"]
    posterior_rad: Float[ndarray, " 2"]
    shrinkage: float

    def apply(self, gaze: Float[ndarray, "T 2 3"], both: Bool[ndarray, " T"]) -> Float[ndarray, "T 2 3"]:
        """Fitted eye-in-head as it would be for pupils that follow the eye, without torsion; `both`: eyes were seen."""
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
    """The unknowns of a clip from fitted eye-in-head, the head, and which eyes were seen open."""
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
    """Slope of eye on head between saccades, with its prior; three rounds, as what is a saccade depends on it."""
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
        weight = np.sum(head[still] ** 2, axis=0) / (noise * lag)  # changes over `lag` frames overlap
        slope = -np.sum(eye[still] * head[still], axis=0) / np.maximum(np.sum(head[still] ** 2, axis=0), 1e-12)
        gain = (prior / settings.gain_sd**2 + weight * slope) / (1.0 / settings.gain_sd**2 + weight)
        gain = np.clip(gain, 0.4, 1.6)
    return np.asarray(gain)


def limit_to_range(gaze: Float[ndarray, "*N 3"], limits: OculomotorRangeSettings) -> Float[ndarray, "*N 3"]:
    """The torsion-free rotation vectors of the same directions, at the edge of the range where they are beyond it."""
    low = (-limits.side_rad, -limits.down_rad)
    return angles_to_gaze(np.clip(gaze_to_angles(gaze), low, (limits.side_rad, limits.up_rad)))
