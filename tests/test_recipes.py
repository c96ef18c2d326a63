"""Recipes for other programs: what they read and send, tested without the programs."""

from __future__ import annotations

import importlib.util
import json
import os
import socket
import struct
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toy_motions

import talkingeyes as te
from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.formats.readers.live_link import ANGLE_SIGNS
from talkingeyes.formats.rotations import euler_yxz
from talkingeyes.head.anny import anny_head
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices

FRAMES = (0, 13, 28, 52, 74)  # frames 28 and 52 have lids beyond the range of the blend shapes


def recipe(repository: Path, name: str) -> Any:
    """A script of docs/recipes as a module."""
    spec = importlib.util.spec_from_file_location(name, repository / "docs" / "recipes" / f"{name}.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("fps", [25.0, 60.0])
def test_live_link_packets_are_those_of_the_app(repository: Path, tmp_path: Path, fps: float) -> None:
    """Unpack a packet from a socket as receivers of the app do."""
    shown = toy_motions.motion(fps)
    te.export(shown, tmp_path / "a.csv")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(20)
        to = f"127.0.0.1:{receiver.getsockname()[1]}"
        script = repository / "docs" / "recipes" / "unreal_live_link.py"
        sender = subprocess.Popen([sys.executable, str(script), str(tmp_path / "a.csv"), "--to", to])
        packets = [receiver.recv(2048) for _ in shown.head]
        assert sender.wait(20) == 0
    eyes = to_forward_axes(shown).gaze
    angles = np.concatenate([euler_yxz(part) * ANGLE_SIGNS for part in (shown.head, eyes[:, 0], eyes[:, 1])], axis=1)
    for index, sent in enumerate(packets):
        length = struct.unpack("!i", sent[41:45])[0]
        assert (struct.unpack("<i", sent[:4])[0], sent[4:5], sent[45 : 45 + length]) == (6, b"$", b"TalkingEyes")
        assert struct.unpack("!if2ib", sent[45 + length : 62 + length]) == (index, 0.0, round(fps), 1, 61)
        values = struct.unpack("!61f", sent[62 + length :])
        np.testing.assert_allclose(values[52:], angles[index], atol=1e-5)
        np.testing.assert_allclose(values[0], max(shown.lid[index, 0], 0.0), atol=1e-5)  # EyeBlinkLeft


def test_gaussian_avatars_finds_its_motion(tmp_path: Path) -> None:
    """What the viewer reads from --motion_path: float32 arrays of these names, a row per frame; others are ignored."""
    shown = toy_motions.flame_motion()
    te.export(shown, tmp_path / "a.npz", format="vhap")
    with np.load(tmp_path / "a.npz") as file:
        taken = {name: value for name, value in file.items() if value.dtype == np.float32}
    widths = {"translation": 3, "rotation": 3, "neck_pose": 3, "jaw_pose": 3, "eyes_pose": 6, "expr": 100}
    assert {name: taken[name].shape for name in widths} == {name: (len(shown), n) for name, n in widths.items()}
    eyes = to_forward_axes(shown).gaze
    np.testing.assert_allclose(taken["eyes_pose"][:, :3], eyes[:, 0], atol=1e-6)  # the left eye first


def test_the_blender_script_reads_the_rate(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "bpy", types.SimpleNamespace(types=types.SimpleNamespace(Material=object)))
    te.export(toy_motions.motion(60.0), tmp_path / "a.glb")
    rate, frames = recipe(repository, "blender_import").read_rate(tmp_path / "a.glb")
    assert (round(rate, 3), frames) == (60.0, 180)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="the package bpy (Blender) is not installed")
def test_blender_poses_the_head_like_this_package(repository: Path, tmp_path: Path) -> None:
    te.export(toy_motions.motion(), tmp_path / "a.glb")
    script = repository / "docs" / "recipes" / "blender_import.py"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}  # bpy may be in a folder of its own
    command = [sys.executable, str(script), str(tmp_path / "a.glb"), str(tmp_path / "a.blend")]
    subprocess.run(command, check=True, env=environment)
    code = f"""
import json, bpy
bpy.ops.wm.open_mainfile(filepath={str(tmp_path / "a.blend")!r})
mesh = next(each for each in bpy.data.objects if each.type == "MESH" and each.data.shape_keys)
found = []
for frame in {FRAMES}:
    bpy.context.scene.frame_set(frame)
    shown = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found.append([tuple(shown.matrix_world @ vertex.co) for vertex in shown.to_mesh().vertices])
json.dump(found, open({str(tmp_path / "a.json")!r}, "w"))
"""
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    x, y, z = np.moveaxis(np.array(json.loads((tmp_path / "a.json").read_text())), -1, 0)
    np.testing.assert_allclose(np.stack([x, z, -y], axis=-1), vertices(), atol=1e-6)


def vertices() -> np.ndarray:
    """The head at FRAMES, posed by this package."""
    moved = to_forward_axes(toy_motions.motion())
    return np.concatenate(
        [posed_vertices(anny_head(), motion_to_pose(anny_head(), moved.cut(frame, frame + 1))) for frame in FRAMES]
    )


def test_the_page_of_recipes_names_every_file(repository: Path) -> None:
    folder = repository / "docs" / "recipes"
    text = (folder / "README.md").read_text()
    files = {path.name for path in folder.iterdir() if path.is_file()} - {"README.md"}
    assert {name for name in files if name not in text} == set()
