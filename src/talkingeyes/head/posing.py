"""Converts a Motion to inputs of a head model: weights of all its blend shapes, and rotations of its joints.

Lids follow gaze and close by the shapes of the Eyelid model if the head has them (`eyelid.blendshapes`), else by
ARKit's (`lid_weights`). The jaw opens by `jawOpen` if the head has it, else by its joint. A Motion contains neither as
expression.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES, eyelid_weights, has_eyelids
from talkingeyes.head.model import HeadModel

SIDES = ("Left", "Right")
LIDS_MEET_WEIGHT = 0.8  # weight of eyeBlink at which the lids meet
JAW_SIDE_RAD = 0.30  # yaw of the jaw at weight 1 of jawLeft or jawRight
GAZE_LID_SHAPES = tuple(
    f"eye{what}{side}" for side in SIDES for what in ("Blink", "LookDown", "LookIn", "LookOut", "LookUp")
)
JAW_SHAPES = ("jawForward", "jawLeft", "jawOpen", "jawRight")


@dataclass(frozen=True)
class Pose:
    """T poses of one head: weights of all its shapes, rotation vectors (radians), translation (metres)."""

    expression: Float[ndarray, "T E"]
    head: Float[ndarray, "T 3"]
    jaw: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]
    translation: Float[ndarray, "T 3"]


def expression_shape_names(model: HeadModel) -> tuple[str, ...]:
    """The expression shapes of a Motion of this head: all but those of gaze, lids and jaw."""
    return tuple(name for name in model.expression_names if name not in GAZE_LID_SHAPES + JAW_SHAPES + LID_SHAPES)


def motion_to_pose(model: HeadModel, motion: Motion) -> Pose:
    """Convert a motion to poses. Raises InputError if its expression is that of another head."""
    strange = [name for name in motion.expression_names if name not in model.expression_names]
    if strange:
        raise InputError(
            f"motion: expression should be of the head {model.name}, got {strange[0]} ({motion.head_model})"
        )
    weights = np.zeros((len(motion), len(model.expression_names)))
    weights[:, [model.shape(name) for name in motion.expression_names]] = motion.expression
    for name, column in shape_weights(model, motion.gaze, motion.lid, motion.jaw).items():
        weights[:, model.shape(name)] += column
    joint = np.zeros_like(motion.jaw) if model.jaw_open_rad else motion.jaw
    return Pose(weights, motion.head, joint, motion.gaze, motion.translation)


def shape_weights(
    model: HeadModel, gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"], jaw: Float[ndarray, "T 3"]
) -> dict[str, Float[ndarray, " T"]]:
    """Weights of the head's shapes for lids and jaw, by name."""
    lids = eyelid_weights(model, gaze, lid) if has_eyelids(model) else lid_weights(gaze, lid)
    weights = {**lids, **jaw_weights(jaw, model.jaw_open_rad)}
    return {name: column for name, column in weights.items() if name in model.expression_names}


def lid_weights(gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"]) -> dict[str, Float[ndarray, " T"]]:
    """Weights of ARKit's lid shapes: those of gaze times the remaining opening, plus the blink.

    Down: the upper lid by eyeLookDown, the lower by a negative eyeSquint; up: by eyeWide, the lower lid by eyeLookUp.
    """
    pitch_deg = np.degrees(gaze_to_angles(gaze)[..., 1])
    down, up = np.maximum(-pitch_deg, 0.0), np.maximum(pitch_deg, 0.0)
    weights = {}
    for eye, side in enumerate(SIDES):
        left_open = 1.0 - lid[:, eye]
        weights[f"eyeLookDown{side}"] = left_open * down[:, eye] / 17.0
        weights[f"eyeSquint{side}"] = -0.5 * left_open * down[:, eye] / 20.0
        weights[f"eyeWide{side}"] = left_open * 0.45 * up[:, eye] / 20.0
        weights[f"eyeLookUp{side}"] = left_open * 0.3 * up[:, eye] / 20.0
        weights[f"eyeBlink{side}"] = LIDS_MEET_WEIGHT * lid[:, eye]
    return weights


def jaw_weights(jaw: Float[ndarray, "T 3"], open_rad: float) -> dict[str, Float[ndarray, " T"]]:
    """Weights of ARKit's jaw shapes, for a head that opens its mouth by them; none if `open_rad` is 0."""
    if not open_rad:
        return {}
    return {
        "jawOpen": np.maximum(jaw[:, 0], 0.0) / open_rad,
        "jawLeft": np.maximum(jaw[:, 1], 0.0) / JAW_SIDE_RAD,
        "jawRight": np.maximum(-jaw[:, 1], 0.0) / JAW_SIDE_RAD,
    }
