"""GLB files as other programs write them: kinds of accessors, places of names, several meshes, rigs."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import face_files
import numpy as np
import pytest
from command_line import call
from scipy.spatial.transform import Rotation

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.editors.channels import AddedEyes
from talkingeyes.formats.editors.face_file import open_face_file
from talkingeyes.formats.joint_names import joints_by_name
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.formats.writers.gltf import Gltf
from talkingeyes.head.anny_build import JAW_OPEN_RAD

FPS, FRAMES = 30.0, 60
BLINKS = ["eyeBlinkLeft", "eyeBlinkRight"]
FACE = ["jawOpen", *(name for name in arkit.NAMES if name.startswith("eye"))]
TIMES_S = np.arange(FRAMES) / FPS
OURS = Motion.of(
    FPS,
    np.stack([0.1 * np.sin(TIMES_S), 0.2 * np.sin(2 * TIMES_S), 0.05 * np.cos(TIMES_S)], axis=1),
    np.repeat(
        np.stack([0.1 * np.sin(5 * TIMES_S), 0.2 * np.cos(3 * TIMES_S), 0 * TIMES_S], axis=1)[:, None], 2, axis=1
    ),
    lid=np.repeat(np.abs(np.sin(4 * TIMES_S))[:, None] ** 8, 2, axis=1),
)


def add_mesh(gltf: Gltf, node: str, names: Sequence[str], place: str = "mesh") -> int:
    """A mesh with a shape for each name, which stand beside the mesh, its primitive, or nowhere."""
    point, named = np.zeros((3, 3), np.float32), {"extras": {"targetNames": list(names)}}
    primitive: dict[str, Any] = {"attributes": {"POSITION": gltf.accessor(point)}}
    primitive["targets"] = [{"POSITION": gltf.sparse_accessor(point)} for _ in names]
    primitive |= named if place == "primitive" else {}
    found = gltf.node(node, mesh=gltf.add("meshes", {"primitives": [primitive], **(named if place == "mesh" else {})}))
    gltf.document["scenes"][0]["nodes"].append(found)
    return found


def face(path: Path, names: Sequence[str], place: str = "mesh", weights: np.ndarray | None = None) -> Path:
    """A face whose jaw moves, without bones."""
    gltf = Gltf()
    node = add_mesh(gltf, "Face", names, place)
    shown = np.zeros((FRAMES, len(names))) if weights is None else weights
    shown[:, 0] = 0.5 + 0.5 * np.sin(TIMES_S)
    gltf.animate({(node, "weights"): shown}, FPS)
    gltf.save(path)
    return path


def rewritten(path: Path, change: Any) -> Path:
    """The file after a change of its JSON and its buffer."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    gltf = Gltf(document=json.loads(data[20 : 20 + length]), blocks=[data[20 + length + 8 :]])
    gltf.size = len(gltf.blocks[0])
    change(gltf)
    path.write_bytes(gltf.encoded())
    return path


def edited(path: Path, joints: dict[str, str] | None = None) -> Motion:
    """What the file holds after our eyes have been put into it."""
    content = open_face_file(path, joints=joints).editor.edited(AddedEyes(OURS, True, 1.0))
    path.with_stem("out").write_bytes(content)
    return read_motion(path.with_stem("out"), joints=joints, eyes="optical").motion


def bones(path: Path, tree: dict[str, str | None], *, moving: Sequence[str] = (), **nodes: Any) -> Path:
    """A rig of bones with parents and axes of their own; those of `moving` turn; `nodes`: properties by name."""
    gltf = Gltf()
    node = add_mesh(gltf, "Mouth", ["jawOpen"])
    index = {
        name: gltf.node(name, rotation=Rotation.from_rotvec([0.3 * k, 0.2, -0.1 * k]).as_quat().tolist())
        for k, name in enumerate(tree)
    }
    for name, parent in tree.items():
        if parent is None:
            gltf.document["scenes"][0]["nodes"].append(index[name])
        else:
            gltf.document["nodes"][index[parent]].setdefault("children", []).append(index[name])
        gltf.document["nodes"][index[name]] |= nodes.get(name, {})
    turned = Rotation.from_rotvec(np.outer(np.sin(3 * TIMES_S), [0.1, 0.15, 0.05]))
    keys = {(node, "weights"): 0.5 + 0.5 * np.sin(TIMES_S)[:, None]}
    for name in moving:
        keys[index[name], "rotation"] = (
            turned * Rotation.from_quat(gltf.document["nodes"][index[name]]["rotation"])
        ).as_quat()
    gltf.animate(keys, FPS)
    gltf.save(path)
    return path


def world_turn(path: Path, name: str) -> np.ndarray:
    """The turn of a node from rest in the axes of the file, at every frame, by the nodes above it."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    content, binary = json.loads(data[20 : 20 + length]), data[20 + length + 8 :]
    animation, nodes = content["animations"][0], content["nodes"]
    local = {}
    for channel in animation["channels"]:
        accessor = content["accessors"][animation["samplers"][channel["sampler"]]["output"]]
        if channel["target"]["path"] == "rotation":
            start = content["bufferViews"][accessor["bufferView"]]["byteOffset"]
            keys = np.frombuffer(binary, "<f4", 4 * FRAMES, start).reshape(-1, 4)
            local[channel["target"]["node"]] = Rotation.from_quat(keys)
    node: int | None = [each["name"] for each in nodes].index(name)
    now = rest = Rotation.identity(FRAMES)
    while node is not None:
        still = Rotation.from_quat(nodes[node].get("rotation", [0, 0, 0, 1]))
        now, rest = local.get(node, still) * now, still * rest
        node = next((k for k, each in enumerate(nodes) if node in each.get("children", ())), None)
    return np.asarray((now * rest.inv()).as_rotvec())


# Accessors.


@pytest.mark.parametrize(
    ("kind", "dtype", "largest"),
    [(5120, "i1", 127), (5121, "u1", 255), (5122, "<i2", 32767), (5123, "<u2", 65535)],
)
def test_normalised_integers_are_divided(tmp_path: Path, kind: int, dtype: str, largest: int) -> None:
    whole = read_motion(face(tmp_path / "float.glb", ["jawOpen"])).motion.jaw

    def as_integers(gltf: Gltf) -> None:
        sampler = gltf.document["animations"][0]["samplers"][0]
        numbers = np.round((0.5 + 0.5 * np.sin(TIMES_S)) * largest).astype(dtype)
        padded = np.zeros((FRAMES, 4), dtype)  # interleaved with other numbers
        padded[:, 1] = numbers
        view = {"buffer": 0, "byteOffset": gltf.size, "byteLength": padded.nbytes, "byteStride": padded.itemsize * 4}
        gltf.blocks.append(padded.tobytes())
        accessor = {"componentType": kind, "normalized": True, "count": FRAMES, "type": "SCALAR"}
        accessor |= {"bufferView": gltf.add("bufferViews", view), "byteOffset": padded.itemsize}
        sampler["output"] = gltf.add("accessors", accessor)

    found = read_motion(rewritten(face(tmp_path / "a.glb", ["jawOpen"]), as_integers)).motion.jaw
    np.testing.assert_allclose(found, whole, atol=1 / largest)

    def not_normalised(gltf: Gltf) -> None:
        del gltf.document["accessors"][-1]["normalized"]

    with pytest.raises(InputError, match="normalised integers, got plain integers"):
        read_motion(rewritten(tmp_path / "a.glb", not_normalised))


def test_sparse_keys_replace_zeros_or_numbers(tmp_path: Path) -> None:
    def sparse(gltf: Gltf) -> None:
        rows, values = gltf.accessor(np.array([3, 7], np.uint16)), gltf.accessor(np.array([0.25, 0.75], np.float32))
        views = [{"bufferView": gltf.document["accessors"][each]["bufferView"]} for each in (rows, values)]
        place = {"count": 2, "indices": {**views[0], "componentType": 5123}, "values": views[1]}
        accessor = {"componentType": 5126, "count": FRAMES, "type": "SCALAR", "sparse": place}
        gltf.document["animations"][0]["samplers"][0]["output"] = gltf.add("accessors", accessor)

    jaw = read_motion(rewritten(face(tmp_path / "a.glb", ["jawOpen"]), sparse)).motion.jaw[:, 0]
    assert list(np.flatnonzero(jaw > 1e-3)) == [3, 7]
    assert jaw[7] == pytest.approx(3 * jaw[3], rel=1e-3)


def test_channels_without_a_node_are_ignored(tmp_path: Path) -> None:
    def pointer(gltf: Gltf) -> None:
        animation = gltf.document["animations"][0]
        target = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/materials/0/alphaCutoff"}}}
        animation["samplers"].append({**animation["samplers"][0], "interpolation": "CUBICSPLINE"})
        animation["channels"].append({"sampler": 1, "target": target})

    path = rewritten(face(tmp_path / "a.glb", FACE), pointer)
    np.testing.assert_allclose(edited(path).lid, OURS.lid, atol=1e-6)
    content = path.with_stem("out").read_bytes()
    assert b"/materials/0/alphaCutoff" in content


def interpolated(gltf: Gltf, values: np.ndarray, times: np.ndarray, interpolation: str) -> None:
    """Give the first channel other keys."""
    sampler = {"input": gltf.accessor(times.astype(np.float32)), "interpolation": interpolation}
    sampler["output"] = gltf.accessor(values.astype(np.float32))
    gltf.document["animations"][0]["samplers"][0] = sampler


def test_cubic_splines_and_steps_are_read_and_edited(tmp_path: Path) -> None:
    times = TIMES_S[:: FRAMES - 1]
    slopes = {"before": [9.0, -2.0], "after": [3.0, 9.0]}  # of the jaw, in units a second
    keys = np.zeros((2, 3, len(FACE)))
    keys[:, :, 0] = np.stack([slopes["before"], [0.2, 0.6], slopes["after"]], axis=1)
    path = rewritten(face(tmp_path / "a.glb", FACE), lambda g: interpolated(g, keys.ravel(), times, "CUBICSPLINE"))
    read = read_motion(path, fps=FPS).motion
    jaw = read.jaw[:, 0] / JAW_OPEN_RAD
    assert len(jaw) == FRAMES
    np.testing.assert_allclose([jaw[0], jaw[-1]], [0.2, 0.6], atol=1e-6)
    np.testing.assert_allclose(np.diff(jaw)[[0, -1]] * FPS, [3.0, -2.0], atol=0.25)
    content = open_face_file(path, fps=FPS).editor.edited(AddedEyes(OURS, True, 1.0))
    path.write_bytes(content)
    found = read_motion(path).motion
    np.testing.assert_allclose(found.jaw, read.jaw, atol=1e-6)
    np.testing.assert_allclose(found.lid, OURS.lid, atol=1e-6)

    steps = np.where(TIMES_S[::10] < 1, 0.25, 0.75)
    path = rewritten(face(tmp_path / "b.glb", ["jawOpen"]), lambda g: interpolated(g, steps, TIMES_S[::10], "STEP"))
    held = read_motion(path, fps=FPS).motion.jaw[:, 0] / JAW_OPEN_RAD
    np.testing.assert_allclose(held[[0, 29, 30]], [0.25, 0.25, 0.75], atol=1e-6)

    turns = Rotation.from_rotvec([[0, 0, 0], [0.1, 0.2, 0]]).as_quat()
    keys = np.stack([np.zeros((2, 4)), turns, np.zeros((2, 4))], axis=1).reshape(-1, 4)
    tree = {"LeftEye": None, "RightEye": None}
    rest = {"rotation": [0, 0, 0, 1]}
    path = bones(tmp_path / "c.glb", tree, moving=("LeftEye",), LeftEye=rest, RightEye=rest)
    path = rewritten(path, lambda g: g.document["animations"][0]["channels"].reverse())  # that of the eye first
    path = rewritten(path, lambda g: g.document["animations"][0]["samplers"].reverse())
    path = rewritten(
        path,
        lambda g: [each.update(sampler=1 - each["sampler"]) for each in g.document["animations"][0]["channels"]],
    )
    path = rewritten(path, lambda g: interpolated(g, keys, times, "CUBICSPLINE"))
    gaze = read_motion(path, fps=FPS, eyes="optical").motion.gaze[:, 0]
    np.testing.assert_allclose(gaze[[0, -1]], [[0, 0, 0], [0.1, 0.2, 0]], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(gaze[FRAMES // 4]) / np.linalg.norm(gaze[-1]), 0.15, atol=0.02)


def test_the_animation_that_moves_the_face_is_taken_unless_another_is_named(tmp_path: Path) -> None:
    def others(gltf: Gltf) -> None:
        """A walk of the body and a still face before it, another face after it."""
        own = gltf.document["animations"][0]
        body = gltf.node("Hips")
        gltf.animate({(body, "translation"): np.zeros((FRAMES, 3))}, FPS)
        gltf.animate({(0, "weights"): np.zeros((FRAMES, len(FACE)))}, FPS)
        gltf.animate({(0, "weights"): np.full((FRAMES, len(FACE)), 0.5)}, FPS)
        whole = gltf.document["animations"]
        for each, name in zip(whole[1:], ("walk", "idle", "shout"), strict=True):
            each["name"] = name
        gltf.document["animations"] = [whole[1], whole[2], own, whole[3]]

    alone = read_motion(face(tmp_path / "alone.glb", FACE)).motion
    path = rewritten(face(tmp_path / "a.glb", FACE), others)
    read = read_motion(path)
    np.testing.assert_array_equal(read.motion.jaw, alone.jaw)
    assert read.notes[0] == "animation motion; --animation NAME takes another: walk, idle, shout"
    assert read_motion(path, animation="shout").motion.jaw[0, 0] == pytest.approx(0.5 * JAW_OPEN_RAD)
    with pytest.raises(InputError, match=r"a\.glb: animation should be one of walk, idle, motion, shout, got sing$"):
        read_motion(path, animation="sing")
    with pytest.raises(InputError, match=r"animation: should be used with GLB, got livelink$"):
        read_motion(face_files.live_link(tmp_path / "a.csv"), animation="walk")
    for name, animation in (("motion", None), ("shout", "shout")):
        file = open_face_file(path, animation=animation)
        assert file.notes[0].startswith(f"animation {name};")
        (tmp_path / "out.glb").write_bytes(file.editor.edited(AddedEyes(OURS, True, 1.0)))
        lids = {each: read_motion(tmp_path / "out.glb", animation=each).motion.lid for each in ("motion", "shout")}
        np.testing.assert_allclose(lids.pop(name), OURS.lid, atol=1e-6)
        assert np.ptp(lids.popitem()[1]) == 0


def as_gltf(path: Path, uri: str) -> Path:
    """The file as text, with its buffer at `uri`; the numbers of the buffer."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    content, binary = json.loads(data[20 : 20 + length]), data[20 + length + 8 :]
    text = uri or f"data:application/octet-stream;base64,{base64.b64encode(binary).decode()}"
    content["buffers"] = [{"byteLength": len(binary), "uri": text}]
    path.with_suffix(".gltf").write_text(json.dumps(content))
    path.with_suffix(".bin").write_bytes(binary)
    return path.with_suffix(".gltf")


def test_buffers_are_read_below_the_folder_of_a_gltf_alone(tmp_path: Path) -> None:
    folder = tmp_path / "avatar"
    (folder / "data ü").mkdir(parents=True)
    path = face(folder / "a.glb", FACE)
    whole = read_motion(path).motion.jaw
    for uri in ("", "a.bin", "data%20%C3%BC/a.bin", "./a.bin"):
        text = as_gltf(path, uri)
        (folder / "data ü" / "a.bin").write_bytes((folder / "a.bin").read_bytes())
        np.testing.assert_array_equal(read_motion(text).motion.jaw, whole, err_msg=uri)
    (tmp_path / "b.bin").write_bytes((folder / "a.bin").read_bytes())
    (folder / "link.bin").symlink_to(tmp_path / "b.bin")
    for uri in ("../b.bin", "%2e%2e/b.bin", str(tmp_path / "b.bin"), "link.bin"):
        with pytest.raises(InputError, match=r"a\.gltf: buffers should be in files below its folder, got "):
            read_motion(as_gltf(path, uri))
    for uri in ("gone.bin", "https://example.com/a.bin"):
        with pytest.raises(InputError, match=rf"^[^\n]*a\.gltf: not a readable glTF with its buffer {uri}[^\n]*$"):
            read_motion(as_gltf(path, uri))


# Names of shapes.


@pytest.mark.parametrize("place", ["mesh", "primitive"])
@pytest.mark.parametrize(
    "spelling",
    ["{}", "head_{}", "Face_{}", "blendShape1.{}", "Mesh|{}", "CTRL_expressions_{}"],
)
@pytest.mark.parametrize("sides", [("Left", "Right"), ("_L", "_R")])
def test_names_of_shapes_are_found(tmp_path: Path, place: str, spelling: str, sides: tuple[str, str]) -> None:
    names = [spelling.format(name.replace("Left", sides[0]).replace("Right", sides[1])) for name in FACE]
    path = face(tmp_path / "a.glb", names, place)
    found = edited(path)
    np.testing.assert_allclose(found.lid, OURS.lid, atol=1e-6)
    np.testing.assert_allclose(found.gaze, OURS.gaze, atol=0.01)
    np.testing.assert_array_equal(found.jaw, read_motion(path).motion.jaw)


@pytest.mark.parametrize("lids", [("Fcl_EYE_Close_L", "Fcl_EYE_Close_R"), ("EyeClosedLeft", "EyeClosedRight")])
def test_lids_of_vroid_and_unified_expressions_close(tmp_path: Path, lids: tuple[str, str]) -> None:
    path = face(tmp_path / "a.glb", ["JawOpen", "Fcl_ALL_Joy", "Fcl_EYE_Close", *lids])
    np.testing.assert_allclose(edited(path).lid, OURS.lid, atol=1e-6)


def test_shapes_without_names_are_one_line(tmp_path: Path) -> None:
    path = face(tmp_path / "a.glb", FACE, "nowhere")
    for read in (read_motion, open_face_file):
        with pytest.raises(InputError, match=rf"^[^\n]*should name its shapes[^\n]*got {len(FACE)} without names$"):
            read(path)

    def one_less(gltf: Gltf) -> None:
        gltf.document["meshes"][0]["extras"]["targetNames"].pop()

    with pytest.raises(InputError, match=f"weights should be {len(FACE) - 1} a frame, got {len(FACE)}"):
        read_motion(rewritten(face(tmp_path / "a.glb", FACE), one_less))


def test_eyes_are_written_to_every_mesh_that_has_such_shapes(tmp_path: Path) -> None:
    gltf = Gltf()
    parts = {
        "Teeth": ["jawOpen"],
        "Face": FACE,
        "Lashes": ["Lash_eyeBlink_L", "Lash_eyeBlink_R"],
        "Brows": ["browDownLeft"],
    }
    nodes = {part: add_mesh(gltf, part, names) for part, names in parts.items()}
    jaw = 0.5 + 0.5 * np.sin(TIMES_S)[:, None]
    gltf.document["nodes"][nodes["Lashes"]]["weights"] = [0.2, 0.2]
    face_weights = np.hstack([jaw, np.zeros((FRAMES, len(FACE) - 1))])
    gltf.animate(
        {
            (nodes["Teeth"], "weights"): jaw * 0,
            (nodes["Face"], "weights"): face_weights,
            (nodes["Brows"], "weights"): jaw,
        },
        FPS,
    )
    gltf.save(tmp_path / "a.glb")
    own, found = read_motion(tmp_path / "a.glb").motion, edited(tmp_path / "a.glb")
    np.testing.assert_allclose(found.lid, OURS.lid, atol=1e-6)
    for name in ("jaw", "expression"):
        np.testing.assert_array_equal(getattr(found, name), getattr(own, name))
    assert own.jaw.any()
    assert own.expression[:, own.expression_names.index("browDownLeft")].any()
    with_others = face(tmp_path / "b.glb", ["jawOpen", "Vrc_Happy", "Vrc_Sad"], weights=np.ones((FRAMES, 3)))
    assert read_motion(with_others).notes[0] == "2 of 3 shapes have no place here: Vrc_Happy, Vrc_Sad"

    def lashes_alone(gltf: Gltf) -> None:
        animation = gltf.document["animations"][0]
        animation["channels"] = [each for each in animation["channels"] if each["target"]["node"] == nodes["Lashes"]]

    lashes = read_motion(rewritten(tmp_path / "out.glb", lashes_alone)).motion
    np.testing.assert_allclose(lashes.lid, OURS.lid, atol=1e-6)


# Rigs.

RIGS = {  # head, left eye, right eye, neck
    "Ready Player Me": ("Head", "LeftEye", "RightEye", "Neck"),
    "VRoid": ("J_Bip_C_Head", "J_Adj_L_FaceEye", "J_Adj_R_FaceEye", "J_Bip_C_Neck"),
    "Mixamo": ("mixamorig:Head", "mixamorig:LeftEye", "mixamorig:RightEye", "mixamorig:Neck"),
    "Mixamo by three.js": ("mixamorig1Head", "mixamorig1LeftEye", "mixamorig1RightEye", "mixamorig1Neck"),
    "Character Creator": ("CC_Base_Head", "CC_Base_L_Eye", "CC_Base_R_Eye", "CC_Base_NeckTwist01"),
    "Rigify": ("DEF-spine.006", "DEF-eye.L", "DEF-eye.R", "DEF-spine.004"),
    "Rigify, made": ("ORG-head", "MCH-eye.L", "MCH-eye.R", "ORG-neck"),
    "MetaHuman": ("head", "FACIAL_L_Eye", "FACIAL_R_Eye", "neck_01"),
    "Daz": ("head", "lEye", "rEye", "neckLower"),
    "Daz 9": ("head", "l_eye", "r_eye", "neck1"),
    "Unity": ("Head", "Left Eye", "Right Eye", "Neck"),
    "MMD": ("頭", "左目", "右目", "首"),
    "MMD in Blender": ("頭", "目.L", "目.R", "首"),
    "Auto-Rig Pro": ("head.x", "c_eye.l", "c_eye.r", "neck.x"),
    "Advanced Skeleton": ("Head_M", "Eye_L", "Eye_R", "Neck_M"),
    "3ds Max": ("Bip001 Head", "Bip001 L Eye", "Bip001 R Eye", "Bip001 Neck"),
    "SMPL-X": ("head", "left_eye_smplhf", "right_eye_smplhf", "neck"),
    "a character's name": ("Bob_Head", "Bob_LeftEyeball", "Bob_RightEyeball", "Bob_Neck"),
    "small letters": ("head", "leye", "reye", "neck"),
}
NO_JOINTS = """LeftEye_end HeadTop_End eyelid.L 左目先 両目 手首 master_eye.L CC_Base_Eye CC_Base_EyeOcclusion
CC_Base_UpperJaw J_Adj_L_FaceEyeSet FACIAL_L_EyelidUpperA FACIAL_L_EyeParallel LeftEyeTarget eyebrow_L forehead necklace
jawline lookAt"""


@pytest.mark.parametrize("rig", RIGS)
def test_bones_of_usual_rigs_turn(tmp_path: Path, rig: str) -> None:
    head, left, right, neck = RIGS[rig]
    path = bones(
        tmp_path / "a.glb", {"Hips": None, neck: "Hips", head: neck, left: head, right: head, "LeftEye_end": left}
    )
    found = edited(path)
    np.testing.assert_allclose(found.gaze, OURS.gaze, atol=1e-6)
    np.testing.assert_allclose(found.head, OURS.head, atol=1e-6)
    np.testing.assert_allclose(world_turn(tmp_path / "out.glb", head), OURS.head, atol=1e-6)
    in_space = (Rotation.from_rotvec(OURS.head) * Rotation.from_rotvec(OURS.gaze[:, 0])).as_rotvec()
    np.testing.assert_allclose(world_turn(tmp_path / "out.glb", left), in_space, atol=1e-6)


def test_other_names_are_no_joints() -> None:
    assert joints_by_name(NO_JOINTS.split()) == {}
    assert joints_by_name(["eye.L", "MCH-eye.L", "DEF-eye.L", "ORG-eye.L"]) == {"left_eye": [2, 0, 3, 1]}


def test_turns_of_neck_and_of_bones_before_an_eye_count(tmp_path: Path) -> None:
    tree = {
        "Spine": None,
        "Neck": "Spine",
        "Head": "Neck",
        "ORG-eye.L": "Head",
        "DEF-eye.L": "ORG-eye.L",
        "DEF-eye.R": "Head",
    }
    path = bones(tmp_path / "a.glb", tree, moving=("Neck", "Head", "ORG-eye.L", "DEF-eye.L"))
    own = read_motion(path, eyes="optical").motion
    np.testing.assert_allclose(own.head, world_turn(path, "Head"), atol=1e-6)
    gaze = Rotation.from_rotvec(world_turn(path, "Head")).inv() * Rotation.from_rotvec(world_turn(path, "DEF-eye.L"))
    np.testing.assert_allclose(own.gaze[:, 0], gaze.as_rotvec(), atol=1e-6)
    found = edited(path)
    np.testing.assert_allclose(found.gaze, OURS.gaze, atol=1e-6)
    np.testing.assert_allclose(world_turn(tmp_path / "out.glb", "Head"), OURS.head, atol=1e-6)


TREE = {"Hips": None, "Bone.2": "Hips", "Bone.3": "Bone.2", "Bone.4": "Bone.2"}
NAMED = {"head": "Bone.2", "left_eye": "Bone.3", "right_eye": "Bone.4"}


def test_the_user_names_joints(tmp_path: Path) -> None:
    path = bones(tmp_path / "a.glb", TREE)
    with pytest.raises(InputError, match=r"--joint left_eye=NAME\), got Mouth, Hips, Bone.2, Bone.3, Bone.4$"):
        open_face_file(path)
    np.testing.assert_allclose(edited(path, NAMED).gaze, OURS.gaze, atol=1e-6)
    np.testing.assert_allclose(edited(path, NAMED).head, OURS.head, atol=1e-6)
    with pytest.raises(InputError, match=r"joint left_eye should be one of Mouth, Hips, .*, got Bone.7$"):
        edited(path, {"left_eye": "Bone.7"})
    with pytest.raises(InputError, match=r"^joint: should be left_eye=NAME, .*, got tail$"):
        edited(path, {"tail": "Bone.2"})
    with pytest.raises(InputError, match=r"joint: should be used with GLB, got livelink$"):
        read_motion(face_files.live_link(tmp_path / "a.csv"), joints=NAMED)


def test_the_command_takes_names_of_joints(tmp_path: Path, capsys: Any) -> None:
    path = bones(tmp_path / "a.glb", TREE, moving=("Bone.3", "Bone.4"))
    options = [word for joint, name in NAMED.items() for word in ("--joint", f"{joint}={name}")]
    status = call("import", str(path), "-o", str(tmp_path / "in.npz"), *options)
    assert (status, "no gaze" in capsys.readouterr().err) == (0, False)
    assert Motion.load(tmp_path / "in.npz").gaze.any()
    status = call("add-eyes", str(path), "x.wav", "-o", "y.glb", "--joint", "eye=Bone.3")
    assert (status, capsys.readouterr().err.count("\n")) == (2, 1)


@pytest.mark.parametrize("version", ["VRM", "VRMC_vrm"])
def test_the_humanoid_of_vrm_comes_first(tmp_path: Path, version: str) -> None:
    nodes = {"Hips": 1, "head": 2, "leftEye": 3, "rightEye": 4}
    if version == "VRM":
        humanoid: Any = [{"bone": name, "node": node} for name, node in nodes.items()]
    else:
        humanoid = {name: {"node": node} for name, node in nodes.items()}

    def add_humanoid(gltf: Gltf) -> None:
        gltf.document["extensions"] = {version: {"humanoid": {"humanBones": humanoid}}}

    path = rewritten(bones(tmp_path / "a.glb", {**TREE, "LeftEye": "Hips"}), add_humanoid)
    np.testing.assert_allclose(edited(path).gaze, OURS.gaze, atol=1e-6)
    behind = [1, 1, 1] if version == "VRMC_vrm" else [-1, 1, -1]  # VRM 0.x faces -z
    np.testing.assert_allclose(world_turn(tmp_path / "out.glb", "Bone.2"), OURS.head * behind, atol=1e-6)


def test_a_rig_that_faces_another_way_turns_about_its_own_axes(tmp_path: Path) -> None:
    still = {"rotation": [0, 0, 0, 1]}
    at = {"LeftEye": {"translation": [0, 0.1, -0.03], **still}, "RightEye": {"translation": [0, 0.1, 0.03], **still}}
    path = bones(tmp_path / "a.glb", {"Head": None, "LeftEye": "Head", "RightEye": "Head"}, Head=still, **at)
    np.testing.assert_allclose(edited(path).head, OURS.head, atol=1e-6)
    x, y, z = OURS.head.T  # the face looks along +x, its left is -z
    np.testing.assert_allclose(world_turn(tmp_path / "out.glb", "Head"), np.stack([z, y, -x], axis=1), atol=1e-6)
