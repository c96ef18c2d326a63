"""Anatomical lid motion as ground truth, from which the Eyelid model is built.

Lids rotate on the eyeball about the axis between the eye corners (Becker & Fuchs 1988). The upper lid follows the eye
downwards with gain 1, and upwards with 0.8 over the first 15 degrees, saturating; the lower lid follows with 0.35.
People are asymmetric, and a lid varies (1.2 degrees) at constant gaze. In a blink the upper lid covers nine tenths of
the opening and the lower lid the rest. Horizontal gaze deforms them in two ways. Lids lie on two spheres, so the bulge
of the cornea lifts them wherever it points. And the outer corner moves to the temple with abduction, 2 mm at the end of
the range, because its tendon is attached to the check ligament of the lateral rectus (Gioia, Linberg & McCormick 1987);
adduction leaves both corners in place. This is deliberately not of the form of the Eyelid model: gains change at zero,
and the lift of a lid is not a sum of sines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.rotation import angles_to_direction
from talkingeyes.head.eyelid.model import LOWER, UPPER
from talkingeyes.head.eyelid.region import CORNER_SKIN, TEMPORAL_AXES, EyelidRegion, elevation, smoothstep

SCLERA_RADIUS_M, CORNEA_RADIUS_M, IRIS_RADIUS_M = 0.0125, 0.0078, 0.0059
CORNEA_CENTRE_M = float(np.sqrt(SCLERA_RADIUS_M**2 - IRIS_RADIUS_M**2) - np.sqrt(CORNEA_RADIUS_M**2 - IRIS_RADIUS_M**2))
IRIS_CENTRE_M = float(np.sqrt(SCLERA_RADIUS_M**2 - IRIS_RADIUS_M**2))
LID_CLEARANCE_M = 0.0008  # minimum distance between lid and eyeball, unless the lid is closer at rest
UPPER_CLOSURE_SHARE = 0.9
JITTER_RAD = np.radians(1.2)
CANTHUS_SHIFT_M, FULL_ABDUCTION_RAD = 0.002, np.radians(45.0)


@dataclass(frozen=True)
class EyelidParameters:
    """Parameters that differ between people and eyes.

    `upper_down`, `upper_up`, `lower`: gains with which lids follow small eye rotations. `droop_rad`: how much lower the
    upper lid rests than in the head model. `lift_rad`, `fall_rad`: angles at which its lift and fall saturate.
    """

    upper_down: float = 1.0
    upper_up: float = 0.88
    lower: float = 0.35
    droop_rad: float = 0.0
    lift_rad: float = float(np.radians(24.0))
    fall_rad: float = float(np.radians(75.0))


def sample_eyelid_parameters(rng: np.random.Generator) -> EyelidParameters:
    """Sample the parameters of an eye: gains within a tenth of the mean, the upper lid up to a few degrees off."""
    down, up, lower = np.clip(rng.normal(1.0, [0.04, 0.06, 0.08]), 0.85, 1.15)
    return EyelidParameters(
        upper_down=float(down),
        upper_up=float(0.88 * up),
        lower=float(0.35 * lower),
        droop_rad=float(rng.normal(0.0, np.radians(1.0))),
        lift_rad=float(np.radians(np.clip(rng.normal(24.0, 3.0), 16.0, 32.0))),
        fall_rad=float(np.radians(np.clip(rng.normal(75.0, 10.0), 50.0, 100.0))),
    )


def upper_lid_rotation_rad(
    pitch_rad: Float[ndarray, "*N"], eyelid_parameters: EyelidParameters
) -> Float[ndarray, "*N"]:
    """Upward rotation of the upper lid at an eye pitch: saturating, less upwards than downwards."""
    up, down = np.maximum(pitch_rad, 0.0), np.maximum(-pitch_rad, 0.0)
    lifted = eyelid_parameters.upper_up * eyelid_parameters.lift_rad * np.tanh(up / eyelid_parameters.lift_rad)
    fallen = eyelid_parameters.upper_down * eyelid_parameters.fall_rad * np.tanh(down / eyelid_parameters.fall_rad)
    return np.asarray(lifted - fallen - eyelid_parameters.droop_rad)


def lid_points(
    region: EyelidRegion,
    angles_rad: Float[ndarray, "T 2"],
    lid: Float[ndarray, " T"],
    eyelid_parameters: EyelidParameters,
    jitter_rad: Float[ndarray, " T"],
) -> Float[ndarray, "T N 3"]:
    """All points of a region in its coordinates, at gaze (yaw, pitch in the head) and closure."""
    upper, lower = _turns(region, angles_rad[:, 1], lid, eyelid_parameters, jitter_rad)
    turned = _turned(region.points, region.upper_share * upper + region.lower_share * lower)
    gaze = angles_to_direction(angles_rad) * TEMPORAL_AXES[region.eye]
    turned[..., 0] += canthus_shift_m(gaze)[:, None] * _canthus_share(region)
    ahead = np.array([0.0, 0.0, 1.0])
    distance = np.linalg.norm(region.points, axis=-1)
    clearance = np.minimum(distance - eyeball_radius_m(region.points / distance[:, None], ahead), LID_CLEARANCE_M)
    moved = (region.upper_share + region.lower_share) > 0
    reach = np.linalg.norm(turned, axis=-1, keepdims=True)
    unit = turned / reach
    least = eyeball_radius_m(unit, gaze[:, None, :])[..., None] + clearance[:, None]
    return np.where(moved[:, None], unit * np.maximum(reach, least), turned)


def canthus_shift_m(gaze: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N"]:
    """Movement of the outer corner towards the temple, for gaze directions in the coordinates of a region."""
    abduction = np.arctan2(gaze[..., 0], gaze[..., 2]) / FULL_ABDUCTION_RAD
    return np.asarray(CANTHUS_SHIFT_M * np.clip(abduction, 0.0, 1.0))


def _canthus_share(region: EyelidRegion) -> Float[ndarray, " N"]:
    """Weight with which each point follows the outer corner: 0 at the inner one, fading in the skin beyond."""
    along = np.clip(region.along, 0.0, 1.0) ** 2
    beyond = 1.0 - smoothstep((region.along - 1.0) / CORNER_SKIN)
    return np.asarray(along * beyond * np.maximum(region.upper_share, region.lower_share))


def eyeball_radius_m(unit: Float[ndarray, "*N 3"], gaze: Float[ndarray, "*M 3"]) -> Float[ndarray, "*N"]:
    """Distance from the centre to the eyeball's surface: the sclera, or the cornea around the gaze direction."""
    cosine = (unit * gaze).sum(axis=-1)
    under = CORNEA_RADIUS_M**2 - CORNEA_CENTRE_M**2 * (1.0 - cosine**2)
    cornea = CORNEA_CENTRE_M * cosine + np.sqrt(np.maximum(under, 0.0))
    return np.where(cosine > 0, np.maximum(SCLERA_RADIUS_M, cornea), SCLERA_RADIUS_M)


def iris_contour(
    angles_rad: Float[ndarray, "T 2"], points: int, rng: np.random.Generator, noise_m: float
) -> Float[ndarray, "T K 3"]:
    """Hand-labelled iris circle in head axes around the eye's centre, with noise."""
    around = np.linspace(0, 2 * np.pi, points, endpoint=False)
    gaze = angles_to_direction(angles_rad)
    side = np.cross([0.0, 1.0, 0.0], gaze)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up = np.cross(gaze, side)
    ring = np.cos(around)[:, None] * side[:, None] + np.sin(around)[:, None] * up[:, None]
    contour = IRIS_CENTRE_M * gaze[:, None] + IRIS_RADIUS_M * ring
    return np.asarray(contour + rng.normal(0.0, noise_m, contour.shape))


def _turns(
    region: EyelidRegion,
    pitch_rad: Float[ndarray, " T"],
    lid: Float[ndarray, " T"],
    eyelid_parameters: EyelidParameters,
    jitter_rad: Float[ndarray, " T"],
) -> tuple[Float[ndarray, "T N"], Float[ndarray, "T N"]]:
    """Rotation of the upper and the lower lid at each point, by its position between the eye corners."""
    follows = upper_lid_rotation_rad(pitch_rad, eyelid_parameters) + jitter_rad
    inside = np.clip(region.along, 0.0, 1.0)
    reach = np.sqrt(4.0 * inside * (1.0 - inside))  # the eye corners are fixed by their ligaments
    place = region.along[UPPER]
    rest = np.interp(inside, place, elevation(region.upper)) - np.interp(
        inside, region.along[LOWER], elevation(region.lower)
    )
    upper, lower = follows[:, None] * reach, (eyelid_parameters.lower * pitch_rad)[:, None] * reach
    closing = lid[:, None] * np.maximum(np.maximum(rest, 0.0) + upper - lower, 0.0)
    return upper - UPPER_CLOSURE_SHARE * closing, lower + (1.0 - UPPER_CLOSURE_SHARE) * closing


def _turned(points: Float[ndarray, "N 3"], angle_rad: Float[ndarray, "T N"]) -> Float[ndarray, "T N 3"]:
    """Points rotated upwards by their angles about the axis between the eye corners."""
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    x, y, z = points.T
    return np.stack([np.broadcast_to(x, angle_rad.shape), cosine * y + sine * z, cosine * z - sine * y], axis=-1)
