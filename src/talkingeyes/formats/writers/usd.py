"""The head and its motion as USD (text, .usda): mesh, skeleton, blend shapes and a SkelAnimation with time samples.

Written as text, so that no library is needed; y up, metres, one time code per frame. Poses are those of GLB (`glb`).
The data of the layer state what the forward axes of the eyes are.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy import ndarray

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.motion import Motion
from talkingeyes.formats.readers.forward_axis import FORWARD_AXIS_KEY
from talkingeyes.formats.rotations import quaternions
from talkingeyes.formats.writers.glb import INFLUENCES, influences, joint_offsets
from talkingeyes.head.model import JOINTS, PARENTS, HeadModel
from talkingeyes.head.posing import motion_to_pose

PATHS = ("root", "root/neck", "root/neck/jaw", "root/neck/left_eye", "root/neck/right_eye")  # in the order of JOINTS


def write_usd(motion: Motion, head: HeadModel, path: Path, eyes: str = "visual") -> None:
    """Write the stage; `eyes` is stated as its forward axes."""
    with atomic_write(path) as partial, partial.open("w") as file:
        for part in (_opening(motion, eyes), _mesh(head), _skeleton(head), _animation(motion, head), ["}"]):
            file.writelines(f"{line}\n" for line in part)


def _opening(motion: Motion, eyes: str) -> Iterator[str]:
    yield "#usda 1.0"
    yield "("
    yield f'    customLayerData = {{\n        string {FORWARD_AXIS_KEY} = "{eyes}"\n    }}'
    yield '    defaultPrim = "Head"'
    yield f"    startTimeCode = 0\n    endTimeCode = {len(motion) - 1}"
    yield f"    timeCodesPerSecond = {motion.fps!r}\n    framesPerSecond = {motion.fps!r}"
    yield '    metersPerUnit = 1\n    upAxis = "Y"'
    yield ")\n"
    yield 'def SkelRoot "Head" (\n    prepend apiSchemas = ["SkelBindingAPI"]\n)\n{'


def _mesh(head: HeadModel) -> Iterator[str]:
    joints, weights = influences(head)
    names = head.expression_names
    yield '    def Mesh "Face" (\n        prepend apiSchemas = ["SkelBindingAPI"]\n    )\n    {'
    yield f"        int[] faceVertexCounts = {_numbers(np.full(len(head.faces), 3))}"
    yield f"        int[] faceVertexIndices = {_numbers(head.faces.ravel())}"
    yield f"        point3f[] points = {_tuples(head.template)}"
    yield '        uniform token subdivisionScheme = "none"'
    colours = _tuples(head.colours)
    yield f'        color3f[] primvars:displayColor = {colours} (\n            interpolation = "vertex"\n        )'
    attributes = f'(\n            elementSize = {INFLUENCES}\n            interpolation = "vertex"\n        )'
    yield f"        int[] primvars:skel:jointIndices = {_numbers(joints.ravel())} {attributes}"
    yield f"        float[] primvars:skel:jointWeights = {_numbers(weights.ravel())} {attributes}"
    yield "        rel skel:skeleton = </Head/Skeleton>"
    yield f"        uniform token[] skel:blendShapes = {_texts(names)}"
    targets = ", ".join(f"</Head/Face/{name}>" for name in names)
    yield f"        rel skel:blendShapeTargets = [{targets}]"
    for name, shape in zip(names, head.expression, strict=True):
        rows = np.flatnonzero(shape.any(axis=1))
        yield f'        def BlendShape "{name}"\n        {{'
        yield f"            uniform vector3f[] offsets = {_tuples(shape[rows])}"
        yield f"            uniform int[] pointIndices = {_numbers(rows)}\n        }}"
    yield "    }"


def _skeleton(head: HeadModel) -> Iterator[str]:
    yield '    def Skeleton "Skeleton" (\n        prepend apiSchemas = ["SkelBindingAPI"]\n    )\n    {'
    yield f"        uniform token[] joints = {_texts(PATHS)}"
    yield f"        uniform matrix4d[] bindTransforms = {_shifts(head.joints)}"
    yield f"        uniform matrix4d[] restTransforms = {_shifts(joint_offsets(head))}"
    yield "        rel skel:animationSource = </Head/Motion>\n    }"


def _animation(motion: Motion, head: HeadModel) -> Iterator[str]:
    pose = motion_to_pose(head, motion)
    turned = np.stack([np.zeros_like(pose.head), pose.head, pose.jaw, pose.gaze[:, 0], pose.gaze[:, 1]], axis=1)
    rotations = np.stack([quaternions(turned[:, joint])[:, [3, 0, 1, 2]] for joint in range(len(JOINTS))], axis=1)
    places = np.tile(joint_offsets(head), (len(motion), 1, 1))
    places[:, PARENTS.index(-1)] += pose.translation
    yield '    def SkelAnimation "Motion"\n    {'
    yield f"        uniform token[] joints = {_texts(PATHS)}"
    yield f"        uniform token[] blendShapes = {_texts(head.expression_names)}"
    yield f"        half3[] scales = {_tuples(np.ones((len(JOINTS), 3)))}"
    for kind, name, values in (("float3", "translations", places), ("quatf", "rotations", rotations)):
        yield from _samples(f"{kind}[] {name}", (_tuples(frame) for frame in values))
    yield from _samples("float[] blendShapeWeights", (_numbers(frame) for frame in pose.expression))
    yield "    }"


def _samples(name: str, frames: Iterator[str]) -> Iterator[str]:
    yield f"        {name}.timeSamples = {{"
    for frame, values in enumerate(frames):
        yield f"            {frame}: {values},"
    yield "        }"


def _shifts(places: ndarray) -> str:
    """Translation matrices; USD uses row vectors."""
    rows = "(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0)"
    return "[" + ", ".join("({}, ({:.9g}, {:.9g}, {:.9g}, 1))".format(rows, *place) for place in places) + "]"


def _numbers(values: ndarray) -> str:
    return "[" + ", ".join(f"{value:.8g}" for value in values.tolist()) + "]"


def _tuples(values: ndarray) -> str:
    return "[" + ", ".join("(" + ", ".join(f"{value:.8g}" for value in row) + ")" for row in values.tolist()) + "]"


def _texts(values: tuple[str, ...]) -> str:
    return "[" + ", ".join(f'"{value}"' for value in values) + "]"
