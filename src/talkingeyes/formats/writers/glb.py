"""The head and its motion as GLB: skinned mesh, named morph targets, rotations of the joints, at the motion's rate.

Axes and units are glTF's (y up, metres, the face towards +z). Every shape of the head is a morph target with its own
name, including those of ARKit. Lids are driven by the shapes of the Eyelid model (docs/eyelid.md). Poses are those of
head/skinning.py, except for FLAME's pose correctives, which glTF does not support. The extras of the asset state what
the forward axes of the eyes are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.formats.readers.forward_axis import FORWARD_AXIS_KEY, LOOK_KEY
from talkingeyes.formats.rotations import quaternions
from talkingeyes.formats.writers.gltf import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Gltf
from talkingeyes.head.model import JOINTS, PARENTS, HeadModel
from talkingeyes.head.normals import vertex_normals
from talkingeyes.head.posing import motion_to_pose

INFLUENCES = 4  # joints per vertex in glTF's first set


def write_glb(motion: Motion, head: HeadModel, path: Path, eyes: str = "visual", look: str | None = None) -> None:
    """Write the head with its motion; `eyes` is stated as its forward axes, and `look`, which lids depend on."""
    gltf = Gltf()
    gltf.document["asset"]["extras"] = {FORWARD_AXIS_KEY: eyes} | ({} if look is None else {LOOK_KEY: look})
    pose = motion_to_pose(head, motion)
    offsets = joint_offsets(head)
    for joint, name in enumerate(JOINTS):
        children = [child for child, parent in enumerate(PARENTS) if parent == joint]
        gltf.node(name, translation=offsets[joint].tolist(), **({"children": children} if children else {}))
    mesh = gltf.node("head", mesh=_mesh(gltf, head), skin=_skin(gltf, head))
    gltf.document["scenes"][0]["nodes"] = [0, mesh]
    gltf.animate(
        {
            (0, "translation"): offsets[0] + pose.translation,
            (1, "rotation"): quaternions(pose.head),
            (2, "rotation"): quaternions(pose.jaw),
            (3, "rotation"): quaternions(pose.gaze[:, 0]),
            (4, "rotation"): quaternions(pose.gaze[:, 1]),
            (mesh, "weights"): pose.expression,
        },
        motion.fps,
    )
    gltf.save(path)


def joint_offsets(head: HeadModel) -> Float[ndarray, "5 3"]:
    """Offset of each joint from its parent."""
    return np.stack(
        [head.joints[joint] - (head.joints[parent] if parent >= 0 else 0.0) for joint, parent in enumerate(PARENTS)]
    )


def influences(head: HeadModel) -> tuple[Int[ndarray, "V 4"], Float[ndarray, "V 4"]]:
    """The joints with the largest weights of each vertex, and their weights, which sum to 1."""
    order = np.argsort(-head.weights, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(head.weights, order, axis=1).astype(np.float64)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.where(weights > 0, order, 0), weights


def _mesh(gltf: Gltf, head: HeadModel) -> int:
    joints, weights = influences(head)
    template = head.template.astype(np.float32)
    normals = vertex_normals(head.template[None].astype(np.float64), head.faces)[0]
    normals[~normals.any(axis=1)] = [0.0, 0.0, 1.0]  # vertices without faces
    material = {
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.6},
        "doubleSided": True,
        "name": "face",
    }
    primitive = {
        "attributes": {
            "POSITION": gltf.accessor(template, ARRAY_BUFFER),
            "NORMAL": gltf.accessor(normals.astype(np.float32), ARRAY_BUFFER),
            "COLOR_0": gltf.accessor(head.colours.astype(np.float32), ARRAY_BUFFER),
            "JOINTS_0": gltf.accessor(joints.astype(np.uint16), ARRAY_BUFFER),
            "WEIGHTS_0": gltf.accessor(weights.astype(np.float32), ARRAY_BUFFER),
        },
        "indices": gltf.accessor(head.faces.ravel().astype(np.uint32), ELEMENT_ARRAY_BUFFER),
        "material": gltf.add("materials", material),
        "targets": [{"POSITION": gltf.sparse_accessor(shape.astype(np.float32))} for shape in head.expression],
    }
    names = list(head.expression_names)
    return gltf.add("meshes", {"name": head.name, "primitives": [primitive], "extras": {"targetNames": names}})


def _skin(gltf: Gltf, head: HeadModel) -> int:
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(JOINTS), 1, 1))
    inverse[:, :3, 3] = -head.joints
    return gltf.add("skins", {"joints": list(range(len(JOINTS))), "inverseBindMatrices": gltf.accessor(inverse)})
