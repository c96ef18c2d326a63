"""Our eyes in files of other programs: what is of the lips keeps its bytes, eyes are those of `export`."""

from __future__ import annotations

import csv
import gzip
import io
import json
import os
import shutil
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import face_files
import flame_file
import numpy as np
import pytest
import soundfile
import toy_motions
from command_line import call
from face_files import LAYOUTS, is_eye
from scipy.spatial.transform import Rotation
from toy_model import sound_file, toy_model

import talkingeyes as te
from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.editors.channels import eye_channels
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.formats.writers.event_keys import detect_events
from talkingeyes.workflows.add_eyes import EyesAdded, add_eyes

REAL = Path(__file__).resolve().parents[1] / "../shared/data/real/gaze"
HEAD_CELLS = ("HeadYaw", "HeadPitch", "HeadRoll", "Yaw", "Pitch", "Roll")
GAZE_CELLS = ("gaze_yaw", "gaze_pitch", "gaze_angle")
ADDED: dict[str, EyesAdded] = {}
pytestmark = pytest.mark.usefixtures("models_loaded_once")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with speech, a model, and a file of each layout."""
    root = tmp_path_factory.mktemp("faces")
    sound_file(root / "speech.wav", seconds=3.0)
    toy_model(root / "model")
    for name, write, _ in LAYOUTS.values():
        write(root / name)
    return root


def added(place: Path, layout: str, out: Path, **options: object) -> EyesAdded:
    """Eyes in the file of a layout, written to `out`; without further options they are made once."""
    name, _, fps = LAYOUTS[layout]
    if options:
        settings: dict[str, Any] = {"seed": 2, "fps": fps, "model": place / "model", **options}
        return add_eyes(place / name, place / "speech.wav", out / name, **settings)
    made = place / f"with eyes, {layout}"
    if layout not in ADDED:
        made.mkdir()
        ADDED[layout] = added(place, layout, made, seed=2)
    shutil.copy(made / name, out)
    return ADDED[layout]


def cells(data: bytes) -> tuple[list[str], list[list[str]]]:
    rows = list(csv.reader(io.StringIO(data.decode("utf-8-sig"))))
    return rows[0], rows[1:]


def changed_columns(before: bytes, after: bytes) -> set[str]:
    """Columns with another text in some row; all else (ends of lines, quotes, spaces) must be the same bytes."""
    names, old = cells(before)
    new_names, new = cells(after)
    assert names == new_names
    assert len(old) == len(new)
    assert before.count(b"\r\n") == after.count(b"\r\n")
    assert before.count(b'"') == after.count(b'"')
    return {name for k, name in enumerate(names) if [row[k] for row in old] != [row[k] for row in new]}


def glb(path: Path):  # type: ignore[no-untyped-def]
    import pygltflib

    return pygltflib.GLTF2().load_binary(str(path))


def keys(gltf, node: str, path: str) -> tuple[np.ndarray, np.ndarray] | None:  # type: ignore[no-untyped-def]
    """Times and values of a channel, read with pygltflib."""

    def numbers(index: int) -> np.ndarray:
        accessor = gltf.accessors[index]
        view = gltf.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
        return np.frombuffer(gltf.binary_blob(), np.float32, accessor.count * width, start).reshape(-1, width)

    for channel in gltf.animations[0].channels:
        if gltf.nodes[channel.target.node].name == node and channel.target.path == path:
            sampler = gltf.animations[0].samplers[channel.sampler]
            return numbers(sampler.input)[:, 0], numbers(sampler.output)
    return None


def named_arrays(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


# Frame rate and length.


@pytest.mark.parametrize("layout", LAYOUTS)
def test_frame_rate_and_length_are_those_of_the_face(place: Path, tmp_path: Path, layout: str) -> None:
    name, _, fps = LAYOUTS[layout]
    done = added(place, layout, tmp_path)
    before, after = (read_motion(folder / name, fps).motion for folder in (place, tmp_path))
    assert len(after) == len(before) == len(done.animation.motion)
    assert after.fps == before.fps == done.animation.motion.fps
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert done.animation.motion.lid.max() > 0.9  # a blink


@pytest.mark.parametrize(
    ("seconds", "said"), [(2.0, "padded the speech with silence"), (9.0, "cut the speech"), (2.5, None)]
)
def test_a_speech_of_another_length_is_padded_or_cut(
    place: Path, tmp_path: Path, seconds: float, said: str | None
) -> None:
    sound_file(tmp_path / "other.wav", seconds)
    out = tmp_path / "a2f.json"
    done = add_eyes(place / "a2f.json", tmp_path / "other.wav", out, model=place / "model")
    notes = [note for note in done.notes if "speech" in note]
    assert len(done.animation.motion) == 75
    assert len(notes) == (said is not None)
    if said:
        assert notes[0] == f"the speech lasts {seconds:.2f} s, the file 2.50 s: {said}"


def test_the_performance_is_that_of_animate(place: Path, tmp_path: Path) -> None:
    done = added(place, "live link", tmp_path)
    sound = soundfile.read(place / "speech.wav", dtype="float32")[0]
    same = te.animate(sound, seed=2, fps=60.0, model=place / "model")
    np.testing.assert_array_equal(done.animation.motion.gaze, same.motion.gaze)
    np.testing.assert_array_equal(done.animation.motion.lid, same.motion.lid)


# Tables.


def test_live_link_has_the_cells_of_export_and_its_own_lips(place: Path, tmp_path: Path) -> None:
    done = added(place, "live link", tmp_path)
    before, after = ((folder / "take.csv").read_bytes() for folder in (place, tmp_path))
    changed = changed_columns(before, after)
    assert all(is_eye(name) or name.startswith("Head") for name in changed)
    assert {"EyeBlinkLeft", "EyeLookOutRight", "LeftEyeYaw", "RightEyePitch", "HeadRoll"} <= changed
    te.export(done.animation, tmp_path / "ours.csv")
    (names, rows), (our_names, our_rows) = cells(after), cells((tmp_path / "ours.csv").read_bytes())
    del our_rows[33]  # the file has no row for this frame
    for name in our_names[2:]:
        if is_eye(name) or name.startswith("Head"):
            assert [row[names.index(name)] for row in rows] == [row[our_names.index(name)] for row in our_rows], name


def test_angles_in_degrees_stay_in_degrees(place: Path, tmp_path: Path) -> None:
    """A program that writes degrees and yaw to the left: both are seen on its look coefficients."""
    done = added(place, "live link", tmp_path)
    te.export(done.animation, tmp_path / "radians.csv")
    names, rows = cells((tmp_path / "radians.csv").read_bytes())
    angles = [k for k, name in enumerate(names) if name.endswith(("Yaw", "Pitch", "Roll"))]
    for row in rows:
        for k in angles:
            sign = -1 if "EyeYaw" in names[k] else 1
            row[k] = f"{sign * np.degrees(float(row[k])):.6f}"
    text = "\n".join(",".join(row) for row in [names, *rows]) + "\n"
    (tmp_path / "degrees.csv").write_text(text)
    again = add_eyes(
        tmp_path / "degrees.csv", place / "speech.wav", tmp_path / "out.csv", seed=2, model=place / "model"
    )
    _, new = cells((tmp_path / "out.csv").read_bytes())
    np.testing.assert_allclose(
        np.array(new)[:, angles].astype(float), np.array(rows)[:, angles].astype(float), atol=2e-5
    )
    np.testing.assert_allclose(again.animation.motion.head, done.animation.motion.head)


def test_audio2face_3d_has_the_coefficients_of_export(place: Path, tmp_path: Path) -> None:
    done = added(place, "audio2face-3d", tmp_path)
    name = LAYOUTS["audio2face-3d"][0]
    before, after = ((folder / name).read_bytes() for folder in (place, tmp_path))
    changed = changed_columns(before, after)
    heads = {"blendShapes.HeadRoll", "blendShapes.HeadPitch", "blendShapes.HeadYaw"}
    assert changed == heads | {f"blendShapes.{n[0].upper()}{n[1:]}" for n in arkit.NAMES if is_eye(n)}
    te.export(done.animation, tmp_path / "ours.csv")
    (names, rows), (our_names, our_rows) = cells(after), cells((tmp_path / "ours.csv").read_bytes())
    for name in changed:
        ours = our_names.index(name.removeprefix("blendShapes."))
        assert [row[names.index(name)] for row in rows] == [row[ours] for row in our_rows], name


@pytest.mark.skipif(not REAL.is_dir(), reason="no real recordings here")
@pytest.mark.parametrize("name", ["pyfeat_news_001", "pyfeat_news_002", "pyfeat_news_005"])
def test_a_recorded_face_keeps_all_but_its_eyes_and_head(place: Path, tmp_path: Path, name: str) -> None:
    path, out = REAL / f"{name}.csv.gz", tmp_path / "out.csv.gz"
    done = add_eyes(path, place / "speech.wav", out, fps=29.97, model=place / "model")
    before, after = (gzip.decompress(each.read_bytes()) for each in (path, out))
    changed = changed_columns(before, after)
    assert changed >= {"eyeBlinkLeft", "eyeLookOutLeft", "Yaw", "gaze_pitch"}
    assert all(is_eye(each) or each in (*HEAD_CELLS, *GAZE_CELLS) for each in changed)
    shown = to_forward_axes(done.animation.motion)
    (names, rows), coefficients = cells(after), arkit.coefficients(shown)
    for k, each in enumerate(arkit.NAMES):
        if is_eye(each):
            column = [float(row[names.index(each)]) for row in rows]
            np.testing.assert_allclose(column, coefficients[:, k], atol=1e-7, err_msg=each)
    read, own = read_motion(out, 29.97).motion, read_motion(path, 29.97).motion
    np.testing.assert_allclose(read.head, shown.head, atol=1e-6)
    np.testing.assert_array_equal(read.jaw, own.jaw)
    assert read.fps == own.fps
    kept = add_eyes(path, place / "speech.wav", tmp_path / "k.csv.gz", fps=29.97, model=place / "model", keep_head=True)
    np.testing.assert_allclose(kept.animation.motion.head, own.head)
    assert not changed_columns(before, gzip.decompress((tmp_path / "k.csv.gz").read_bytes())) & set(HEAD_CELLS)


# JSON.


@pytest.mark.parametrize("own_names", [True, False])
def test_audio2face_keeps_its_text_but_for_the_eyes(place: Path, tmp_path: Path, own_names: bool) -> None:
    path = face_files.audio2face_json(tmp_path / "in.json", names=None if own_names else list(arkit.NAMES))
    done = add_eyes(path, place / "speech.wav", tmp_path / "out.json", seed=2, model=place / "model")
    before, after = path.read_text(), (tmp_path / "out.json").read_text()
    old, new = json.loads(before), json.loads(after)
    changed = [(a, b) for a, b in zip(before.splitlines(), after.splitlines(), strict=True) if a != b]
    assert 100 < len(changed) < before.count("\n")  # a number a line: indented
    names = old["facsNames"]
    eyes = [k for k, name in enumerate(names) if is_eye(name)]
    assert sum(row[k] != other[k] for row, other in zip(old["weightMat"], new["weightMat"], strict=True) for k in eyes)
    restored = iter(before.splitlines())
    lines = after.splitlines()
    first = next(k for k, line in enumerate(lines) if '"weightMat"' in line)
    for index, (line, own) in enumerate(zip(lines, restored, strict=True)):
        column = (index - first - 2) % (len(names) + 2)  # a row has a line for each name, and two brackets
        if line != own:
            assert column in eyes, line
    wanted = eye_channels(to_forward_axes(done.animation.motion))
    for k in eyes:
        values = wanted[names[k].lower()]
        np.testing.assert_allclose([row[k] for row in new["weightMat"]], values, atol=1e-7)
    assert done.notes[-1].startswith("no place for the head")
    np.testing.assert_array_equal(done.animation.motion.head, 0)
    if own_names:
        closed = np.array(new["weightMat"])[:, names.index("eyesCloseL")]
        np.testing.assert_allclose(closed, np.clip(done.animation.motion.lid[:, 0], 0, 1), atol=1e-7)
        yaw = np.array(new["weightMat"]) @ [(n == "eyesLookLeft") - 1.0 * (n == "eyesLookRight") for n in names]
        gaze = rotation.gaze_to_angles(to_forward_axes(done.animation.motion).gaze)[..., 0].mean(axis=1)
        np.testing.assert_allclose(yaw * 37, np.degrees(gaze), atol=0.05)  # left is the subject's


def test_lam_keeps_all_but_the_eyes(place: Path, tmp_path: Path) -> None:
    done = added(place, "lam", tmp_path)
    old, new = (json.loads((folder / "bsData.json").read_text()) for folder in (place, tmp_path))
    te.export(done.animation, tmp_path / "ours.json", format="arkit")
    ours = json.loads((tmp_path / "ours.json").read_text())
    assert old["metadata"] == new["metadata"]
    for before, after, wanted in zip(old["frames"], new["frames"], ours["coefficients"], strict=True):
        assert before["time"] == after["time"]
        for k, name in enumerate(arkit.NAMES):
            assert after["weights"][k] == (wanted[k] if is_eye(name) else before["weights"][k]), name


def test_our_json_has_the_rotations_of_export(place: Path, tmp_path: Path) -> None:
    sound = place / "speech.wav"
    te.export(te.animate(sound, seed=1, model=place / "model"), tmp_path / "in.json", format="arkit")
    done = add_eyes(tmp_path / "in.json", sound, tmp_path / "out.json", seed=2, model=place / "model")
    te.export(done.animation, tmp_path / "ours.json", format="arkit")
    own, new, ours = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("in", "out", "ours"))
    assert new["eyes"] == ours["eyes"] != own["eyes"]
    assert new["head"] == ours["head"] != own["head"]
    assert new["translation"] == own["translation"] != ours["translation"] or not np.any(own["translation"])


# glTF.


@pytest.mark.parametrize("eye_shapes", [True, False])
def test_an_avatar_looks_about_the_axes_of_its_own_bones(place: Path, tmp_path: Path, eye_shapes: bool) -> None:
    path, out = face_files.avatar_glb(tmp_path / "in.glb", eye_shapes=eye_shapes), tmp_path / "out.glb"
    done = add_eyes(path, place / "speech.wav", out, seed=2, model=place / "model")
    shown, old, new = to_forward_axes(done.animation.motion), glb(path), glb(out)
    assert new.binary_blob().startswith(old.binary_blob())
    for node, kind in (("Face", "weights"), ("Teeth", "weights")):
        before, after = keys(old, node, kind), keys(new, node, kind)
        assert before is not None and after is not None
        np.testing.assert_array_equal(before[0], after[0])
        names = old.meshes[old.nodes[[n.name for n in old.nodes].index(node)].mesh].extras["targetNames"]
        table, own = (each[1].reshape(75, len(names)) for each in (after, before))
        lips = [not is_eye(name) for name in names]
        assert table[:, lips].tobytes() == own[:, lips].tobytes()
        for k, name in enumerate(names):
            if is_eye(name):
                wanted = arkit.coefficients(shown)[:, arkit.NAMES.index(name)]
                np.testing.assert_allclose(table[:, k], wanted, atol=1e-6)
    found = keys(new, "Head", "rotation")
    assert found is not None
    above = face_files.SPINE
    in_world = above * Rotation.from_quat(found[1]) * (above * face_files.HEAD).inv()
    np.testing.assert_allclose(in_world.as_rotvec(), shown.head, atol=1e-6)
    for eye, node in enumerate(("LeftEye", "RightEye")):
        found, before = keys(new, node, "rotation"), keys(old, node, "rotation")
        assert found is not None and before is not None
        turn = (above * face_files.HEAD) * Rotation.from_quat(found[1])
        turn = turn * (above * face_files.HEAD * face_files.EYE).inv()
        wanted = shown.gaze[:, eye] * (0 if eye_shapes else 1)  # shapes turn the eyes where the face has them
        np.testing.assert_allclose(turn.as_rotvec(), wanted, atol=1e-6)
        assert eye_shapes == (found[1].tobytes() == before[1].tobytes())


BLENDER = """
import json, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 30
bpy.ops.import_scene.gltf(filepath=sys.argv[1])
rig = next(each for each in bpy.data.objects if each.type == "ARMATURE")
faces = [each for each in bpy.data.objects if each.type == "MESH" and each.data.shape_keys]
face = max(faces, key=lambda each: len(each.data.shape_keys.key_blocks))
found = []
for frame in json.loads(sys.argv[2]):
    bpy.context.scene.frame_set(frame)
    shown = bpy.context.evaluated_depsgraph_get()
    turned = {bone.name: [list(row)[:3] for row in (bone.matrix @ bone.bone.matrix_local.inverted())][:3]
              for bone in rig.evaluated_get(shown).pose.bones}
    keys = {key.name: key.value for key in face.evaluated_get(shown).data.shape_keys.key_blocks}
    found.append({"turned": turned, "keys": keys})
json.dump(found, open(sys.argv[3], "w"))
"""


@pytest.mark.slow
@pytest.mark.skipif(find_spec("bpy") is None, reason="the package bpy (Blender) is not installed")
@pytest.mark.parametrize("eye_shapes", [True, False])
def test_blender_reads_the_avatar_back(place: Path, tmp_path: Path, eye_shapes: bool) -> None:
    path, out = face_files.avatar_glb(tmp_path / "in.glb", eye_shapes=eye_shapes), tmp_path / "out.glb"
    done = add_eyes(path, place / "speech.wav", out, seed=2, model=place / "model")
    frames = [1, 20, 40, 60, 74]
    command = [sys.executable, "-c", BLENDER, str(out), json.dumps(frames), str(tmp_path / "read.json")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(command, check=True, capture_output=True, env=environment)
    shown, to_blender = to_forward_axes(done.animation.motion), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    names = [name for name in arkit.NAMES if eye_shapes or not name.startswith("eyeLook")]
    lips, ours = face_files.weights(75, len(names)), arkit.coefficients(shown)
    for frame, read in zip(frames, json.loads((tmp_path / "read.json").read_text()), strict=True):
        head = rotation.rotvec_to_matrix(shown.head[frame])
        eyes = [head @ rotation.rotvec_to_matrix(shown.gaze[frame, eye] * (not eye_shapes)) for eye in range(2)]
        for name, wanted in (("Head", head), ("LeftEye", eyes[0]), ("RightEye", eyes[1])):
            np.testing.assert_allclose(read["turned"][name], to_blender @ wanted @ to_blender.T, atol=1e-5)
        for k, name in enumerate(names):
            value = ours[frame, arkit.NAMES.index(name)] if is_eye(name) else lips[frame, k]
            assert read["keys"][name] == pytest.approx(value, abs=1e-6), name


def test_our_glb_has_the_channels_of_export(place: Path, tmp_path: Path) -> None:
    sound = place / "speech.wav"
    own = te.animate(sound, seed=1, model=place / "model").motion
    jaw = np.stack([0.2 + 0.1 * np.sin(np.arange(len(own))), 0 * own.lid[:, 0], 0 * own.lid[:, 0]], axis=1)
    own = Motion.of(own.fps, own.head, own.gaze, lid=own.lid, jaw=jaw)
    te.export(own, tmp_path / "in.glb")
    done = add_eyes(tmp_path / "in.glb", sound, tmp_path / "out.glb", seed=2, model=place / "model")
    te.export(done.animation, tmp_path / "ours.glb")
    before, after, ours = (glb(tmp_path / f"{name}.glb") for name in ("in", "out", "ours"))
    for node in ("neck", "left_eye", "right_eye"):
        np.testing.assert_allclose(keys(after, node, "rotation")[1], keys(ours, node, "rotation")[1], atol=1e-6)  # type: ignore[index]
    for node, path in (("jaw", "rotation"), ("root", "translation")):
        assert keys(after, node, path)[1].tobytes() == keys(before, node, path)[1].tobytes()  # type: ignore[index]
    names = before.meshes[0].extras["targetNames"]
    old, new, wanted = (
        keys(each, "head", "weights")[1].reshape(len(own), len(names))  # type: ignore[index]
        for each in (before, after, ours)
    )
    for k, name in enumerate(names):
        eyes = is_eye(name) or name.startswith("lid")
        np.testing.assert_allclose(new[:, k], (wanted if eyes else old)[:, k], atol=1e-6, err_msg=name)
    assert new[:, names.index("jawOpen")].tobytes() == old[:, names.index("jawOpen")].tobytes()


def test_a_vrm_animation_of_lips_looks_and_blinks(place: Path, tmp_path: Path) -> None:
    done = added(place, "vrm", tmp_path)
    old, new = (glb(folder / "lips.vrma") for folder in (place, tmp_path))
    for node in ("aa", "ih"):
        assert keys(new, node, "translation")[1].tobytes() == keys(old, node, "translation")[1].tobytes()  # type: ignore[index]
    assert keys(new, "neck", "rotation")[1].tobytes() == keys(old, "neck", "rotation")[1].tobytes()  # type: ignore[index]
    te.export(done.animation, tmp_path / "ours.vrma")
    vrm, ours = new.extensions["VRMC_vrm_animation"], glb(tmp_path / "ours.vrma")
    assert set(vrm["expressions"]["preset"]) == {"aa", "ih", "blinkLeft", "blinkRight"}
    roots = new.scenes[0].nodes
    for name, node, path in (
        ("lookAt", vrm["lookAt"]["node"], "rotation"),
        ("blinkLeft", vrm["expressions"]["preset"]["blinkLeft"]["node"], "translation"),
        ("blinkRight", vrm["expressions"]["preset"]["blinkRight"]["node"], "translation"),
    ):
        assert new.nodes[node].name == name
        assert node in roots
        np.testing.assert_allclose(keys(new, name, path)[1], keys(ours, name, path)[1], atol=1e-6)  # type: ignore[index]
    neck, head = (Rotation.from_quat(keys(new, name, "rotation")[1]) for name in ("neck", "head"))  # type: ignore[index]
    np.testing.assert_allclose((neck * head).as_rotvec(), done.animation.motion.head, atol=1e-6)


def test_a_vrm_animation_with_arkit_expressions_has_these_moved(place: Path, tmp_path: Path) -> None:
    custom = ("eyeBlinkLeft", "EyeLookInRight", "mouthFunnel")
    path, out = face_files.lips_vrma(tmp_path / "in.vrma", custom=custom), tmp_path / "out.vrma"
    done = add_eyes(path, place / "speech.wav", out, seed=2, model=place / "model")
    new, ours = glb(out), arkit.coefficients(to_forward_axes(done.animation.motion))
    for name in custom[:2]:
        values = keys(new, name, "translation")[1]  # type: ignore[index]
        np.testing.assert_allclose(values[:, 0], ours[:, arkit.NAMES.index(name[0].lower() + name[1:])], atol=1e-6)
    assert not keys(new, "mouthFunnel", "translation")[1].any()  # type: ignore[index]
    vrm = new.extensions["VRMC_vrm_animation"]
    assert "lookAt" not in vrm  # expressions turn the eyes, and lids close once
    assert set(vrm["expressions"]["preset"]) == {"aa", "ih"}
    read = read_motion(out).motion
    np.testing.assert_allclose(arkit.coefficients(read)[:, 0], ours[:, 0], atol=1e-6)
    assert len(done.events.blinks) == len(detect_events(done.animation.motion).blinks)


def test_a_face_without_shapes_for_gaze_is_said_to_have_no_saccades(place: Path, tmp_path: Path) -> None:
    names = [name for name in arkit.NAMES if not name.startswith("eyeLook")]
    path = face_files.audio2face_json(tmp_path / "a.json", names=names)
    done = add_eyes(path, place / "speech.wav", tmp_path / "out.json", model=place / "model")
    assert "no place for gaze in the file: no saccades" in done.notes
    assert not done.events.saccades


def test_a_rig_without_lids_is_said_to_have_no_blinks(place: Path, tmp_path: Path) -> None:
    path = face_files.avatar_glb(tmp_path / "bones.glb", lids=False)
    done = add_eyes(path, place / "speech.wav", tmp_path / "out.glb", model=place / "model")
    assert done.animation.events.blinks
    assert not done.events.blinks
    assert "no place for lids in the file: no blinks" in done.notes


# FLAME.


def test_vhap_keeps_its_other_arrays(place: Path, tmp_path: Path) -> None:
    done = added(place, "vhap", tmp_path)
    before, after = (named_arrays(folder / "tracked.npz") for folder in (place, tmp_path))
    changed = {name for name in after if after[name] != before.get(name)}
    assert changed == {"rotation.npy", "neck_pose.npy", "eyes_pose.npy", "eyelids.npy"}
    shown = to_forward_axes(done.animation.motion)
    with np.load(tmp_path / "tracked.npz") as new:
        np.testing.assert_allclose(new["eyes_pose"], shown.gaze.reshape(-1, 6), atol=1e-6)
        np.testing.assert_allclose(new["neck_pose"], shown.head, atol=1e-6)
        np.testing.assert_allclose(new["eyelids"], shown.lid, atol=1e-6)
        assert not new["rotation"].any()
        assert new["eyes_pose"].dtype == np.float32


def test_former_lids_leave_the_expression_of_our_vhap(place: Path, tmp_path: Path) -> None:
    shown = toy_motions.flame_motion()
    flame_file.write(tmp_path / "flame.pkl", flame_file.arrays())
    te.export(shown, tmp_path / "in.npz", format="vhap", model=tmp_path / "flame.pkl")
    add_eyes(tmp_path / "in.npz", place / "speech.wav", tmp_path / "out.npz", seed=2, model=place / "model")
    with np.load(tmp_path / "in.npz") as before, np.load(tmp_path / "out.npz") as after:
        assert np.abs(before["expr"] - shown.expression).max() > 0.1
        np.testing.assert_allclose(after["expr"], shown.expression, atol=1e-5)
        assert not after["eyelid_expr"].any()


@pytest.mark.parametrize("eyes", [None, "optical"])
def test_our_flame_layout_has_an_array_an_eye(place: Path, tmp_path: Path, eyes: str | None) -> None:
    te.export(toy_motions.flame_motion(), tmp_path / "in.npz", format="flame")
    done = add_eyes(
        tmp_path / "in.npz", place / "speech.wav", tmp_path / "out.npz", seed=2, model=place / "model", eyes=eyes
    )
    before, after = (named_arrays(tmp_path / f"{name}.npz") for name in ("in", "out"))
    changed = {name.removesuffix(".npy") for name in after if after[name] != before.get(name)}
    assert changed == {"neck_pose", "leye_pose", "reye_pose", "eyelids"}
    shown = to_forward_axes(done.animation.motion, eyes or "visual")
    with np.load(tmp_path / "out.npz") as new:
        np.testing.assert_allclose(new["leye_pose"], shown.gaze[:, 0], atol=1e-6)
        np.testing.assert_allclose(new["reye_pose"], shown.gaze[:, 1], atol=1e-6)


def test_diffposetalk_gets_eyes_and_keeps_its_jaw(place: Path, tmp_path: Path) -> None:
    done = added(place, "diffposetalk", tmp_path)
    before, after = (named_arrays(folder / "sample.npz") for folder in (place, tmp_path))
    assert {name for name in after if after[name] != before.get(name)} == {"pose.npy", "eyes_pose.npy", "eyelids.npy"}
    with np.load(place / "sample.npz") as old, np.load(tmp_path / "sample.npz") as new:
        assert new["pose"][:, 3:].tobytes() == old["pose"][:, 3:].tobytes()
        np.testing.assert_allclose(new["pose"][:, :3], done.animation.motion.head, atol=1e-6)
        np.testing.assert_allclose(
            new["eyes_pose"], to_forward_axes(done.animation.motion).gaze.reshape(-1, 6), atol=1e-6
        )


def test_unils_keeps_its_other_columns(place: Path, tmp_path: Path) -> None:
    done = added(place, "unils", tmp_path)
    old, new = (np.load(folder / "motion.npy") for folder in (place, tmp_path))
    others = [k for k in range(108) if not 100 <= k < 103 and k < 104]
    assert new[:, others].tobytes() == old[:, others].tobytes()
    wanted = to_forward_axes(done.animation.motion).gaze[..., :2].reshape(-1, 4)
    np.testing.assert_allclose(new[:, 104:], wanted, atol=1e-6)


# Head and blend, in all layouts.


@pytest.mark.parametrize("layout", LAYOUTS)
def test_keep_head_keeps_the_head_and_gaze_in_space(place: Path, tmp_path: Path, layout: str) -> None:
    name, _, fps = LAYOUTS[layout]
    kept = added(place, layout, tmp_path, keep_head=True)
    before, after = (read_motion(folder / name, fps).motion for folder in (place, tmp_path))
    np.testing.assert_array_equal(after.head, before.head)
    np.testing.assert_allclose(kept.animation.motion.head, before.head, atol=1e-9)
    free = te.animate(place / "speech.wav", seed=2, fps=before.fps, model=place / "model").motion.cut(0, len(before))
    sound_lasts = abs(before.seconds - 3.0) < 1e-6
    if sound_lasts:  # otherwise the sound was cut, and the performance is another
        spaces = [rotation.gaze_in_space(each.head, each.gaze) for each in (free, kept.animation.motion)]
        np.testing.assert_allclose(spaces[0], spaces[1], atol=0.01)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_blend_mixes_the_eyes_of_both(place: Path, tmp_path: Path, layout: str) -> None:
    name, _, fps = LAYOUTS[layout]
    found = []
    for share in (0.0, 0.5, 1.0):
        (tmp_path / f"{share}").mkdir()
        added(place, layout, tmp_path / f"{share}", **({"blend": share} if share < 1 else {}))
        found.append(read_motion(tmp_path / f"{share}" / name, fps).motion)
    own, (none, half, whole) = read_motion(place / name, fps).motion, found
    if layout not in ("avatar", "vrm", "vhap", "diffposetalk"):  # which lack channels that are added
        assert (tmp_path / "0.0" / name).read_bytes() == (place / name).read_bytes()
    np.testing.assert_array_equal(none.jaw, own.jaw)
    if layout == "audio2face":  # with names of its own, which the reader does not know
        shares = [json.loads((tmp_path / f"{share}" / name).read_text())["weightMat"] for share in (0.0, 0.5, 1.0)]
        np.testing.assert_allclose(shares[1], (np.array(shares[0]) + np.array(shares[2])) / 2, atol=2e-7)
        assert np.abs(np.array(shares[2]) - np.array(shares[0])).max() > 0.3
    elif layout not in ("vrm", "diffposetalk", "avatar"):
        np.testing.assert_array_equal(none.gaze, own.gaze)
        np.testing.assert_allclose(half.lid, (none.lid + whole.lid) / 2, atol=1e-5)
        looks = [rotation.gaze_to_angles(to_forward_axes(each).gaze) for each in found]
        assert np.abs(looks[1] - (looks[0] + looks[2]) / 2).max() < 0.01
        assert np.abs(looks[2] - looks[0]).max() > 0.02
    if layout in ("live link", "vhap", "unils"):
        np.testing.assert_allclose(half.head, (none.head + whole.head) / 2, atol=0.01)
        np.testing.assert_allclose(none.head, own.head, atol=1e-6)
    if layout == "avatar":  # eyes by shapes and head are at rest in the file
        np.testing.assert_allclose(half.lid, whole.lid / 2, atol=1e-6)
        np.testing.assert_allclose(half.head, whole.head / 2, atol=1e-6)


# The command line, and mistakes.


def test_the_command_says_what_it_wrote(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    out = str(tmp_path / "out.json")
    words = ["add-eyes", "a2f.json", "speech.wav", "-o", out, "--model", "model", "--seed", "2"]
    assert call(*words) == 0
    said = capsys.readouterr()
    assert said.out.startswith(f"{out}: arkit, 2.50 s at 30 fps, ")
    assert said.err.splitlines() == [
        f"{out}: note: the speech lasts 3.00 s, the file 2.50 s: cut the speech",
        f"{out}: note: no place for the head in the file: the eyes move in a still head",
    ]
    first = Path(out).read_bytes()
    assert call(*words) == 2
    assert "--force" in capsys.readouterr().err
    assert call(*words, "--force") == 0
    assert Path(out).read_bytes() == first
    assert call(*words, "--force", "--eye-contact", "1", "--person", "nobody") == 2
    assert Path(out).read_bytes() == first


BAD = [
    ("take.csv", {"blend": 1.5}, "blend: should be 0"),
    ("take.csv", {"out": "out.json"}, "should be a name that ends in .csv"),
    ("take.csv", {"eyes": "crossed"}, "eyes: should be one of visual, optical"),
    ("sample.npz", {}, "should contain its frame rate, got none; set --fps"),
    ("sample.npz", {"fps": 5.0}, "fps: should be 10 to 240"),
    ("none.csv", {}, "no such file"),
    ("letters.csv", {}, "should have shapes of a face (EyeLookInLeft"),
    ("letters.json", {}, "should be JSON with fps, names and coefficients"),
    ("lips.json", {}, "should have coefficients of eyes"),
    ("words.json", {}, "should be numbers, one for each name"),
    ("lips.glb", {}, "should have joints or shapes of eyes"),
    ("cut.glb", {}, "cut.glb"),
    ("cut.npz", {"fps": 25.0}, "cut.npz"),
    ("motion.npz", {}, "got a motion; `animate --replace face=` takes its face"),
    ("lips.npy", {"fps": 25.0}, "should have eyes"),
    ("openface.csv", {}, "got a table of openface"),
    ("face.fbx", {}, "should end in one of .csv"),
    ("short.csv", {"fps": 60.0}, "should last at least 0.3 s"),
]


@pytest.fixture(scope="module")
def bad(place: Path) -> Path:
    """Files that cannot have eyes, beside the good ones."""
    (place / "letters.csv").write_text("a,b\n1,2\n2,3\n")
    (place / "letters.json").write_text("[1, 2]")
    names = ["jawOpen", "mouthClose"]
    (place / "lips.json").write_text(json.dumps({"names": names, "fps": 30, "coefficients": [[0.1, 0.2]] * 30}))
    table = json.loads((place / "a2f.json").read_text())
    table["weightMat"][4][2] = "much"
    (place / "words.json").write_text(json.dumps(table))
    (place / "cut.glb").write_bytes((place / "avatar.glb").read_bytes()[:5000])
    (place / "cut.npz").write_bytes((place / "sample.npz").read_bytes()[:5000])
    Motion.of(25.0, np.zeros((50, 3)), np.zeros((50, 2, 3))).save(place / "motion.npz")
    np.save(place / "lips.npy", np.zeros((50, 53), np.float32))
    columns = "frame,timestamp,confidence,success,gaze_angle_x,gaze_angle_y,pose_Rx,pose_Ry,pose_Rz"
    rows = [f"{k},{k / 30:.3f},0.98,1,0.01,0.1,0,{k / 300},0" for k in range(40)]
    (place / "openface.csv").write_text("\n".join([columns, *rows]) + "\n")
    (place / "face.fbx").touch()
    face_files.live_link(place / "short.csv", frames=8)
    gltf = face_files.Gltf()
    gltf.node("Head")
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (30, 1))
    gltf.animate({(0, "rotation"): turns}, 30.0)
    gltf.save(place / "lips.glb")
    return place


@pytest.mark.parametrize(("name", "options", "message"), BAD)
def test_bad_input_is_one_line_and_writes_nothing(
    bad: Path, tmp_path: Path, name: str, options: dict[str, object], message: str
) -> None:
    arguments = {"model": bad / "model", "out": f"out{Path(name).suffix}", **options}
    out = tmp_path / str(arguments.pop("out"))
    with pytest.raises(InputError) as error:
        add_eyes(bad / name, bad / "speech.wav", out, **arguments)  # type: ignore[arg-type]
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_what_is_reported_is_counted_in_the_written_file(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["add-eyes", str(place / "take.csv"), str(place / "speech.wav"), "--model", str(place / "model")]
    words += ["--seed", "2", "-o"]
    assert call(*words, str(tmp_path / "whole.csv")) == 0
    found = detect_events(read_motion(tmp_path / "whole.csv").motion)
    assert found.blinks
    said = capsys.readouterr().out
    assert said.endswith(
        f"3.00 s at 60 fps, {len(found.saccades)} saccades, {len(found.blinks)} blinks by {place / 'model'}\n"
    )
    assert call(*words, str(tmp_path / "own.csv"), "--blend", "0") == 0  # the eyes of the file are still
    assert capsys.readouterr().out.endswith(f" 0 blinks by {place / 'model'}\n")


def test_frames_without_a_face_are_reported(place: Path, tmp_path: Path) -> None:
    done = added(place, "live link", tmp_path)
    assert "1 of 180 frames have no face in the file, and no eyes" in done.notes


def test_an_edited_file_that_cannot_be_read_is_not_written(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("talkingeyes.formats.editors.table.TableFile.edited", lambda *_: b"a,b\n1,2\n")
    with pytest.raises(InputError, match=r"take\.csv: the edited file: should have shapes of a face"):
        added(place, "live link", tmp_path, seed=2)
    assert not list(tmp_path.iterdir())


def test_eyes_move_on_a_head_that_has_no_place(place: Path, tmp_path: Path) -> None:
    """Azure's visemes roll the head; other turns cannot be written there."""
    rows = [[0.0] * 52 + [0.002 * k, 0.0, 0.0] for k in range(120)]
    (tmp_path / "a.json").write_text(json.dumps({"FrameIndex": 0, "BlendShapes": rows}))
    done = add_eyes(tmp_path / "a.json", place / "speech.wav", tmp_path / "b.json", model=place / "model")
    assert done.notes[-1] == "no place for the head in the file: the eyes move in the head of the file"
    np.testing.assert_allclose(done.animation.motion.head, read_motion(tmp_path / "a.json").motion.head, atol=1e-9)


def test_a_file_in_its_own_place_is_replaced_whole(place: Path, tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    path.write_bytes((place / "take.csv").read_bytes())
    with pytest.raises(InputError, match="--force"):
        add_eyes(path, place / "speech.wav", path, model=place / "model")
    add_eyes(path, place / "speech.wav", path, model=place / "model", force=True)
    assert changed_columns((place / "take.csv").read_bytes(), path.read_bytes())


def test_a_mark_and_spaces_of_a_json_stay(place: Path, tmp_path: Path) -> None:
    text = (
        '{"names" : ["eyeBlinkLeft", "jawOpen"],\t"fps":30.0, "coefficients":[ '
        + ", ".join(["[0, 1E-1]"] * 30)
        + " ] }\n"
    )
    (tmp_path / "in.json").write_bytes(b"\xef\xbb\xbf" + text.encode())
    add_eyes(tmp_path / "in.json", place / "speech.wav", tmp_path / "out.json", model=place / "model")
    after = (tmp_path / "out.json").read_bytes().decode()
    assert after.startswith('\ufeff{"names" : ["eyeBlinkLeft", "jawOpen"],\t"fps":30.0, "coefficients":[ [')
    assert after.count(", 1E-1]") == 30
    np.testing.assert_allclose(read_motion(tmp_path / "out.json").motion.jaw[:, 0], 0.0506, atol=1e-4)
