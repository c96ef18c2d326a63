"""Head, gaze and blinks as a VRM animation (.vrma, VRMC_vrm_animation 1.0), for any VRM avatar.

A bare humanoid in T-pose. The bone `head` rotates; the look-at node has one yaw and pitch for both eyes (the mean
direction, because VRM has no vergence); blinks and mouth opening are expressions, whose weight is the x of a node's
translation. VRM faces +z, as this project does. The extras of the asset state what the forward axes of the eyes are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.readers.forward_axis import FORWARD_AXIS_KEY
from talkingeyes.formats.rotations import from_euler_yxz, quaternions
from talkingeyes.formats.writers.gltf import Gltf

# The bones that VRM requires: parent, offset in metres.
BONES: dict[str, tuple[str, tuple[float, float, float]]] = {
    "hips": ("", (0.0, 0.95, 0.0)),
    "spine": ("hips", (0.0, 0.15, 0.0)),
    "neck": ("spine", (0.0, 0.40, 0.0)),
    "head": ("neck", (0.0, 0.08, 0.0)),
    **{
        f"{side}{bone}": (f"{side}{parent}" if parent[0].isupper() else parent, (sign * x, y, z))
        for side, sign in (("left", 1.0), ("right", -1.0))
        for bone, parent, x, y, z in (
            ("UpperArm", "spine", 0.17, 0.33, 0.0),
            ("LowerArm", "UpperArm", 0.27, 0.0, 0.0),
            ("Hand", "LowerArm", 0.25, 0.0, 0.0),
            ("UpperLeg", "hips", 0.09, -0.05, 0.0),
            ("LowerLeg", "UpperLeg", 0.0, -0.42, 0.0),
            ("Foot", "LowerLeg", 0.0, -0.40, 0.0),
        )
    },
}
OFFSET_FROM_HEAD = [0.0, 0.06, 0.08]  # of the midpoint between the eyes


def write_vrm(motion: Motion, path: Path, eyes: str = "visual") -> None:
    """Write the animation; `eyes` is stated as its forward axes."""
    gltf = Gltf()
    gltf.document["asset"]["extras"] = {FORWARD_AXIS_KEY: eyes}
    bones = {name: gltf.node(name, translation=list(offset)) for name, (_, offset) in BONES.items()}
    for name, (parent, _) in BONES.items():
        if parent:
            gltf.document["nodes"][bones[parent]].setdefault("children", []).append(bones[name])
    looking = gltf.node("lookAt")
    weights = expressions(motion)
    shown = {name: gltf.node(name) for name in weights}
    gltf.document["scenes"][0]["nodes"] = [bones["hips"], looking, *shown.values()]
    still = np.zeros((len(motion), 2))
    gltf.animate(
        {
            (bones["head"], "rotation"): quaternions(motion.head),
            (looking, "rotation"): quaternions(look_at(motion)),
            **{(shown[name], "translation"): np.column_stack([column, still]) for name, column in weights.items()},
        },
        motion.fps,
    )
    gltf.document["extensionsUsed"] = ["VRMC_vrm_animation"]
    gltf.document["extensions"] = {
        "VRMC_vrm_animation": {
            "specVersion": "1.0",
            "humanoid": {"humanBones": {name: {"node": node} for name, node in bones.items()}},
            "expressions": {"preset": {name: {"node": node} for name, node in shown.items()}},
            "lookAt": {"node": looking, "offsetFromHeadBone": OFFSET_FROM_HEAD},
        }
    }
    gltf.save(path)


def look_at(motion: Motion) -> Float[ndarray, "T 3"]:
    """Rotation vectors of the look-at node: the mean direction of both eyes, in the head."""
    angles = rotation.cyclopean_gaze(rotation.gaze_to_angles(motion.gaze))
    return from_euler_yxz(np.stack([angles[:, 0], -angles[:, 1], np.zeros(len(motion))], axis=1))


def expressions(motion: Motion) -> dict[str, ndarray]:
    """Weights, 0 to 1, of the VRM presets that a motion drives."""
    table = dict(zip(arkit.NAMES, arkit.coefficients(motion).T, strict=True))
    return {"blinkLeft": table["eyeBlinkLeft"], "blinkRight": table["eyeBlinkRight"], "aa": table["jawOpen"]}
