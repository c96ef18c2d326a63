"""Person-specific lids that follow gaze, expressed as `Motion.lid`, the parameter of the Eyelid model.

The upper lid follows the eye fully downwards and increasingly less upwards (Becker & Fuchs 1988; see
`head.eyelid.anatomy`): gains differ between directions and saturate, people and their two eyes differ, and lids drift
slowly by up to 5 degrees at constant gaze. The Eyelid model of the head (Elisei et al. 2007) is linear in sines of gaze
and cannot represent this. `Motion.lid` is therefore the value of the model's third parameter that puts the upper lid
where the person's is: 0 where both agree, 1 shut, negative wider. The lower lid is the model's. A head animated with
the motion, and its landmarks, then show this person's lids; a lid of 0 shows the mean person's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyelid.anatomy import EyelidParameters, sample_eyelid_parameters, upper_lid_rotation_rad
from talkingeyes.head.eyelid.blendshapes import AHEAD, LID_SHAPES, SIDES
from talkingeyes.head.eyelid.model import gaze_predictors

LID_LAG_S = 0.005  # delay of the lid after the eye
MIN_OPENING_M = 0.002  # lower limit of the opening when a lid height is converted to a closure
MIN_CLOSURE, MAX_CLOSURE = -0.5, 0.6  # limits of closure without a blink
LID_ASYMMETRY_RAD = np.radians(0.5)


def sample_eyelids(rng: np.random.Generator) -> tuple[EyelidParameters, EyelidParameters]:
    """Sample the lids of the left and right eye: alike, but with slightly different rest positions."""
    person, apart_rad = sample_eyelid_parameters(rng), LID_ASYMMETRY_RAD * rng.standard_normal(2)
    left, right = (replace(person, droop_rad=float(person.droop_rad + each)) for each in apart_rad)
    return left, right


def lid_closure_by_gaze(
    angles_rad: Float[ndarray, "T 2 2"],
    lid_pitch_rad: Float[ndarray, "T 2"],
    drift_rad: Float[ndarray, "T 2"],
    eyes: tuple[EyelidParameters, EyelidParameters],
) -> Float[ndarray, "T 2"]:
    """`Motion.lid` without blinks for eye-in-head angles (yaw, pitch). `lid_pitch_rad`: the pitch that lids follow."""
    frame = _lid_frame()
    inputs = gaze_predictors(angles_rad) - AHEAD
    modelled_m = np.einsum("tep,ep->te", inputs, frame.upper_by_gaze)
    turned = (
        np.stack([upper_lid_rotation_rad(lid_pitch_rad[:, eye], eyes[eye]) for eye in range(2)], axis=-1) + drift_rad
    )
    person_m = frame.radius_m * (np.sin(frame.rest_rad + turned) - np.sin(frame.rest_rad))
    left_open = np.maximum(frame.opening_m + np.einsum("tep,ep->te", inputs, frame.opening_by_gaze), MIN_OPENING_M)
    return np.asarray(np.clip((modelled_m - person_m) / (frame.upper_share * left_open), MIN_CLOSURE, MAX_CLOSURE))


def add_blinks(open_: Float[ndarray, "T 2"], shut: Float[ndarray, "T 2"]) -> Float[ndarray, "T 2"]:
    """Add blinks to lids: from any position, close the fraction `shut` of the remaining opening."""
    return np.asarray(open_ + (1.0 - open_) * shut)


@dataclass(frozen=True)
class _LidFrame:
    """Lid geometry of both eyes of the head.

    `rest_rad`, `radius_m`: angle and distance of the resting upper lid from the eye's centre. `upper_by_gaze`,
    `opening_by_gaze`: change of lid height and opening with the model's predictors (metres). `upper_share`: fraction of
    a closure that the upper lid covers.
    """

    rest_rad: Float[ndarray, " 2"]
    radius_m: Float[ndarray, " 2"]
    opening_m: Float[ndarray, " 2"]
    upper_by_gaze: Float[ndarray, "2 4"]
    opening_by_gaze: Float[ndarray, "2 4"]
    upper_share: Float[ndarray, " 2"]


@cache
def _lid_frame() -> _LidFrame:
    head = anny_head()
    names, first = head.landmarks.names, head.shape(LID_SHAPES[0])
    rest, shapes = head.landmarks.of(head.template), head.landmarks.of(head.expression[first : first + 10])
    at = {lid: [[names.index(f"{side}_eye_{lid}_{x}") for x in ("outer", "inner")] for side in SIDES]
          for lid in ("upper", "lower")}  # fmt: skip
    upper, lower = rest[at["upper"]].mean(axis=1), rest[at["lower"]].mean(axis=1)
    moved = shapes.reshape(2, 5, len(names), 3)[..., 1]
    up, low = (np.stack([moved[eye][:, at[lid][eye]].mean(axis=-1) for eye in range(2)]) for lid in ("upper", "lower"))
    arm = upper - head.eye_centres
    return _LidFrame(
        rest_rad=np.arctan2(arm[:, 1], arm[:, 2]),
        radius_m=np.hypot(arm[:, 1], arm[:, 2]),
        opening_m=upper[:, 1] - lower[:, 1],
        upper_by_gaze=up[:, :4],
        opening_by_gaze=(up - low)[:, :4],
        upper_share=up[:, 4] / (up - low)[:, 4],
    )
