"""The open head as a VRM 1.0 avatar: the GLB of our writer, with bones, look-at and expressions."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.core.motion import Motion
from talkingeyes.formats.readers.gltf_document import GltfDocument, open_gltf
from talkingeyes.formats.writers.glb import write_glb
from talkingeyes.formats.writers.vrm import BONES
from talkingeyes.head.anny import anny_head

RANGE = {"inputMaxValue": 90.0, "outputScale": 90.0}  # eyes turn by the angle that is asked for
LICENSE = "https://vrm.dev/licenses/1.0/"


def vrm_model(path: Path) -> Path:
    """Write the avatar. Its bone `head` is the head's joint at the neck; it has a body of bones without a mesh."""
    read = still_head(path)
    content = read.content
    nodes = content["nodes"]
    names = [node["name"] for node in nodes]
    bones = {"head": names.index("neck"), "leftEye": names.index("left_eye"), "rightEye": names.index("right_eye")}
    body = [name for name in BONES if name != "head"]
    bones |= {name: len(nodes) + index for index, name in enumerate(body)}
    nodes += [{"name": name, "translation": list(BONES[name][1]), "children": []} for name in body]
    for name in body:
        if BONES[name][0]:
            nodes[bones[BONES[name][0]]]["children"].append(bones[name])
    nodes[bones["neck"]]["children"].append(names.index("root"))
    nodes[names.index("root")]["translation"] = [0.0, 0.0, 0.0]
    for name in body:
        if not nodes[bones[name]]["children"]:
            del nodes[bones[name]]["children"]
    content["scenes"][0]["nodes"] = [bones["hips"], names.index("head")]
    targets = content["meshes"][0]["extras"]["targetNames"]
    shapes = {"blinkLeft": "lidBlinkLeft", "blinkRight": "lidBlinkRight", "aa": "jawOpen"}
    binds = {
        preset: {"morphTargetBinds": [{"node": names.index("head"), "index": targets.index(shape), "weight": 1.0}]}
        for preset, shape in shapes.items()
    }
    sides = ("rangeMapHorizontalInner", "rangeMapHorizontalOuter", "rangeMapVerticalDown", "rangeMapVerticalUp")
    content["extensionsUsed"] = ["VRMC_vrm"]
    content["extensions"] = {
        "VRMC_vrm": {
            "specVersion": "1.0",
            "meta": {"name": "open head", "authors": ["TalkingEyes"], "licenseUrl": LICENSE},
            "humanoid": {"humanBones": {name: {"node": node} for name, node in bones.items()}},
            "lookAt": {"type": "bone", "offsetFromHeadBone": [0.0, 0.04, 0.08], **dict.fromkeys(sides, RANGE)},
            "expressions": {"preset": binds},
        }
    }
    return write_content(path, content, read.binary)


def still_head(path: Path) -> GltfDocument:
    """Write the open head as GLB without animation, and read it back."""
    write_glb(Motion.of(25.0, np.zeros((2, 3)), np.zeros((2, 2, 3))), anny_head(), path)
    read = open_gltf(path)
    del read.content["animations"]
    return read


def write_content(path: Path, content: dict[str, Any], binary: bytes) -> Path:
    """Write a GLB with a changed document."""
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0")
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, size) + chunks + binary)
    return path
