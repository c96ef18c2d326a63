"""ARKit's 52 blend shape coefficients: conversion from and to Motion.

    eyeLookOut (left eye) = eyeLookIn (right eye) = max(yaw, 0) / LOOK_RANGE_RAD        In = toward the nose

Yaw is positive to the subject's left, so the left eye then looks outward. Coefficients range from 0 to 1. A look
coefficient of 1 corresponds to 37 degrees, the median over eleven recordings of Live Link Face (34 to 42 degrees of
yaw; pitch was not measured and uses the same value). `eyeBlink` is the closure of the lids; `eyeWide` is lid opening
beyond that for the gaze alone. The other 38 coefficients are `Motion.expression` of the open head. Angles beyond 37
degrees and the roll of the jaw are lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.head.anny_build import JAW_OPEN_RAD
from talkingeyes.head.posing import GAZE_LID_SHAPES, JAW_SHAPES, JAW_SIDE_RAD, SIDES

LOOK_RANGE_RAD = float(np.radians(37.0))
WIDE_CLOSURE = 0.3  # closure is -0.3 at eyeWide 1, the widest lids of synthetic data
EYE_COEFFICIENTS = ("eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide")
_FACE = """jawForward jawLeft jawRight jawOpen mouthClose mouthFunnel mouthPucker mouthLeft mouthRight mouthSmileLeft
mouthSmileRight mouthFrownLeft mouthFrownRight mouthDimpleLeft mouthDimpleRight mouthStretchLeft mouthStretchRight
mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper mouthPressLeft mouthPressRight mouthLowerDownLeft
mouthLowerDownRight mouthUpperUpLeft mouthUpperUpRight browDownLeft browDownRight browInnerUp browOuterUpLeft
browOuterUpRight cheekPuff cheekSquintLeft cheekSquintRight noseSneerLeft noseSneerRight tongueOut"""
NAMES = (*(f"{what}{side}" for side in SIDES for what in EYE_COEFFICIENTS), *_FACE.split())  # Live Link's order
ANGLES = tuple(
    f"{part}{angle}" for part in ("Head", "LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll")
)  # of Live Link Face, beside the coefficients
EXPRESSION = tuple(
    name for name in NAMES if name not in GAZE_LID_SHAPES + JAW_SHAPES
)  # expression coefficients of a Motion


@dataclass(frozen=True)
class DecodedFace:
    """Decoded coefficients: eye-in-head rotation vectors, closure, jaw, and the other 38 coefficients."""

    gaze: Float[ndarray, "T 2 3"]
    lid: Float[ndarray, "T 2"]
    jaw: Float[ndarray, "T 3"]
    expression: Float[ndarray, "T 38"]


def coefficients(motion: Motion) -> Float[ndarray, "T 52"]:
    """The 52 coefficients (0 to 1, in the order of NAMES) of a motion with no expression or that of the open head."""
    columns = {
        **_looks(rotation.gaze_to_angles(motion.gaze)),
        "jawOpen": motion.jaw[:, 0] / JAW_OPEN_RAD,
        "jawLeft": motion.jaw[:, 1] / JAW_SIDE_RAD,
        "jawRight": -motion.jaw[:, 1] / JAW_SIDE_RAD,
    }
    for eye, side in enumerate(SIDES):
        columns[f"eyeBlink{side}"] = motion.lid[:, eye]
        columns[f"eyeWide{side}"] = -motion.lid[:, eye] / WIDE_CLOSURE
    table = np.zeros((len(motion), len(NAMES)))
    for name, column in columns.items():
        table[:, NAMES.index(name)] = np.maximum(column, 0.0)
    for name, column in zip(motion.expression_names, motion.expression.T, strict=True):
        table[:, NAMES.index(name)] += column
    return np.clip(table, 0.0, 1.0)


def decoded(table: Float[ndarray, "T 52"]) -> DecodedFace:
    """The inverse of `coefficients`. eyeWide becomes negative closure, so it is 0 in the expression."""
    column = dict(zip(NAMES, table.T, strict=True))
    looks, lids = [], []
    for side, outward in zip(SIDES, (1.0, -1.0), strict=True):
        yaw = outward * (column[f"eyeLookOut{side}"] - column[f"eyeLookIn{side}"])
        looks.append(np.stack([yaw, column[f"eyeLookUp{side}"] - column[f"eyeLookDown{side}"]], axis=-1))
        lids.append(column[f"eyeBlink{side}"] - WIDE_CLOSURE * column[f"eyeWide{side}"])
    jaw = [JAW_OPEN_RAD * column["jawOpen"], JAW_SIDE_RAD * (column["jawLeft"] - column["jawRight"])]
    expression = [np.zeros(len(table)) if "eyeWide" in name else column[name] for name in EXPRESSION]
    return DecodedFace(
        gaze=rotation.angles_to_gaze(LOOK_RANGE_RAD * np.stack(looks, axis=1)),
        lid=np.stack(lids, axis=1),
        jaw=np.stack([*jaw, np.zeros(len(table))], axis=1),
        expression=np.stack(expression, axis=1),
    )


def _looks(angles_rad: Float[ndarray, "T 2 2"]) -> dict[str, Float[ndarray, " T"]]:
    columns = {}
    for eye, side in enumerate(SIDES):
        yaw, pitch = angles_rad[:, eye].T / LOOK_RANGE_RAD
        outward = yaw if side == "Left" else -yaw
        columns[f"eyeLookOut{side}"], columns[f"eyeLookIn{side}"] = outward, -outward
        columns[f"eyeLookUp{side}"], columns[f"eyeLookDown{side}"] = pitch, -pitch
    return columns
