"""Writers of other formats: output is read by independent readers and compared with the motion; import inverts it."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import av
import flame_file
import numpy as np
import pytest
import toy_motions
import trimesh
from scipy.spatial.transform import Rotation

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.formats.writers.arkit import timecode
from talkingeyes.head.anny import anny_head
from talkingeyes.head.flame import load_flame
from talkingeyes.head.looks import dressed_head
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.rendering.shading import to_pixels
from talkingeyes.workflows import convert
from talkingeyes.workflows.render import render

FRAMES = (0, 13, 52)  # at rest, in a saccade, in a blink


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a motion for each head model."""
    folder = tmp_path_factory.mktemp("made")
    toy_motions.motion().save(folder / "anny.npz")
    toy_motions.flame_motion().save(folder / "flame.npz")
    return folder


def exported(made: Path, tmp_path: Path, format: str, source: str = "anny") -> Path:
    out = tmp_path / f"out{convert.FORMATS[format].suffix}"
    convert.export(made / f"{source}.npz", out, format=format)
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    return out


def of_rig() -> Motion:
    """The motion with lines of sight as forward axes of the eyes, as exports have it by default."""
    return to_forward_axes(toy_motions.motion())


@pytest.fixture(scope="module")
def vertices() -> np.ndarray:
    """Posed vertices of the open head at FRAMES."""
    return posed(anny_head())


def posed(head: HeadModel) -> np.ndarray:
    moved = of_rig()
    return np.concatenate([posed_vertices(head, motion_to_pose(head, moved.cut(frame, frame + 1))) for frame in FRAMES])


@pytest.mark.parametrize(
    ("format", "names"),
    [
        ("flame", {"neck_pose": "head", "jaw_pose": "jaw", "expression": "expression", "transl": "translation"}),
        ("vhap", {"neck_pose": "head", "jaw_pose": "jaw", "expr": "expression", "translation": "translation"}),
    ],
)
def test_flame_parameters_are_arrays_by_name(made: Path, tmp_path: Path, format: str, names: dict[str, str]) -> None:
    shown = to_forward_axes(toy_motions.flame_motion())
    with np.load(exported(made, tmp_path, format, "flame"), allow_pickle=False) as file:
        for name, field in names.items():
            assert file[name].dtype == np.float32
            np.testing.assert_allclose(file[name], getattr(shown, field), atol=1e-6)
        eyes = file["eyes_pose"] if format == "vhap" else np.hstack([file["leye_pose"], file["reye_pose"]])
        texts = [str(file[name]) for name in ("eye_order", "head_model", "forward_axis")]
        assert (file["fps"], texts) == (25.0, ["left,right (the subject's)", "flame", "visual"])
        if format == "vhap":
            assert (file["shape"].shape, file["static_offset"].shape) == ((300,), (1, 5143, 3))
            assert not file["rotation"].any()
            np.testing.assert_array_equal(file["timestep_id"], np.arange(len(shown)))
    np.testing.assert_allclose(eyes, shown.gaze.reshape(-1, 6), atol=1e-6)


def test_diffposetalk_is_shape_exp_and_pose(made: Path, tmp_path: Path) -> None:
    shown = toy_motions.flame_motion()
    with np.load(exported(made, tmp_path, "diffposetalk", "flame"), allow_pickle=False) as file:
        assert (file["shape"].shape, file["exp"].shape) == ((100,), (len(shown), 50))
        np.testing.assert_allclose(file["pose"], np.hstack([shown.head, shown.jaw]), atol=1e-6)


def test_live_link_has_names_time_codes_and_radians(made: Path, tmp_path: Path) -> None:
    with exported(made, tmp_path, "livelink").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:4] == ["Timecode", "BlendShapeCount", "EyeBlinkLeft", "EyeLookDownLeft"]
    assert len(rows[0]) == 63
    assert {row["BlendShapeCount"] for row in rows} == {"61"}
    assert all(re.fullmatch(r"\d\d:\d\d:\d\d:\d\d\.\d{3}", row["Timecode"]) for row in rows)
    shown = of_rig()
    yaw, pitch = np.moveaxis(rotation.gaze_to_angles(shown.gaze), -1, 0)
    for eye, side in enumerate(("Left", "Right")):
        np.testing.assert_allclose([float(row[f"{side}EyeYaw"]) for row in rows], -yaw[:, eye], atol=1e-6)
        np.testing.assert_allclose([float(row[f"{side}EyePitch"]) for row in rows], -pitch[:, eye], atol=1e-6)
        shut = [float(row[f"EyeBlink{side}"]) for row in rows]
        np.testing.assert_allclose(shut, np.maximum(shown.lid[:, eye], 0), atol=1e-6)
    smile = shown.expression[:, shown.expression_names.index("mouthSmileLeft")]
    np.testing.assert_allclose([float(row["MouthSmileLeft"]) for row in rows], smile, atol=1e-6)


def test_in_is_toward_the_nose_and_left_is_the_subjects() -> None:
    left, up = np.radians([[10.0, 0.0], [0.0, 10.0]])
    gaze = rotation.angles_to_gaze(np.stack([[left, left], [-left, -left], [up, -up]]))
    table = dict(zip(arkit.NAMES, arkit.coefficients(Motion.of(25.0, np.zeros((3, 3)), gaze)).T, strict=True))
    looks = {name: column.round(4).tolist() for name, column in table.items() if "Look" in name}
    ten = round(10 / 37, 4)
    assert looks["eyeLookOutLeft"] == looks["eyeLookInRight"] == [ten, 0, 0]  # to the subject's left
    assert looks["eyeLookInLeft"] == looks["eyeLookOutRight"] == [0, ten, 0]
    assert (looks["eyeLookUpLeft"], looks["eyeLookDownRight"]) == ([0, 0, ten], [0, 0, ten])


@pytest.mark.parametrize(
    ("frame", "fps", "code"),
    [
        (0, 60.0, "00:00:00:00.000"),
        (90, 60.0, "00:00:01:30.000"),
        (90_000, 25.0, "01:00:00:00.000"),
        (30, 29.97, "00:00:01:00.030"),
    ],
)
def test_time_codes(frame: int, fps: float, code: str) -> None:
    assert timecode(frame, fps) == code


def test_arkit_json_names_its_columns(made: Path, tmp_path: Path) -> None:
    content = json.loads(exported(made, tmp_path, "arkit").read_text())
    table = np.array(content["coefficients"])
    assert table.shape == (75, 52)
    assert 0 <= table.min() <= table.max() <= 1
    np.testing.assert_allclose(
        table[:, content["names"].index("jawOpen")], toy_motions.motion().jaw[:, 0] / 0.506, atol=1e-6
    )
    np.testing.assert_allclose(content["eyes"], of_rig().gaze, atol=1e-6)


def accessor(gltf, index: int) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Values of a pygltflib accessor, sparse or dense."""
    found = gltf.accessors[index]
    kinds = {5126: np.float32, 5125: np.uint32, 5123: np.uint16}
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[found.type]

    def view(number: int, kind: int, count: int, columns: int) -> np.ndarray:
        start = gltf.bufferViews[number].byteOffset
        return np.frombuffer(gltf.binary_blob(), kinds[kind], count * columns, start).reshape(count, columns)

    if found.sparse is None:
        return view(found.bufferView, found.componentType, found.count, width)
    dense = np.zeros((found.count, width), np.float32)
    rows = view(found.sparse.indices.bufferView, found.sparse.indices.componentType, found.sparse.count, 1)[:, 0]
    dense[rows] = view(found.sparse.values.bufferView, found.componentType, found.sparse.count, width)
    return dense


def channels(gltf) -> dict[tuple[str, str], np.ndarray]:  # type: ignore[no-untyped-def]
    """Values of the animation by node name and path; all have the times of the motion."""
    found = {}
    for channel in gltf.animations[0].channels:
        sampler = gltf.animations[0].samplers[channel.sampler]
        np.testing.assert_allclose(accessor(gltf, sampler.input)[:, 0], np.arange(75) / 25, atol=1e-6)
        found[gltf.nodes[channel.target.node].name, channel.target.path] = accessor(gltf, sampler.output)
    return found


def test_glb_poses_the_head_like_this_package(made: Path, tmp_path: Path) -> None:
    import pygltflib

    gltf = pygltflib.GLTF2().load(str(exported(made, tmp_path, "glb")))
    moved, mesh, skin = channels(gltf), gltf.meshes[0], gltf.skins[0]
    names = mesh.extras["targetNames"]
    assert set(arkit.NAMES) <= set(names)
    part = mesh.primitives[0]
    shapes = np.stack([accessor(gltf, target["POSITION"]) for target in part.targets])
    joints, weights = accessor(gltf, part.attributes.JOINTS_0), accessor(gltf, part.attributes.WEIGHTS_0)
    inverse = accessor(gltf, skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
    amounts = moved["head", "weights"].reshape(75, len(names))
    for frame, wanted in zip(FRAMES, posed(dressed_head()), strict=True):
        world: dict[int, np.ndarray] = {}

        def visit(node: int, above: np.ndarray, frame: int = frame, world: dict[int, np.ndarray] = world) -> None:
            here = gltf.nodes[node]
            local = np.eye(4)
            turn = moved.get((here.name, "rotation"))
            place = moved.get((here.name, "translation"))
            local[:3, :3] = np.eye(3) if turn is None else Rotation.from_quat(turn[frame]).as_matrix()
            local[:3, 3] = here.translation if place is None else place[frame]
            world[node] = above @ local
            for child in here.children:
                visit(child, world[node])

        visit(gltf.scenes[0].nodes[0], np.eye(4))
        rest = accessor(gltf, part.attributes.POSITION) + np.tensordot(amounts[frame], shapes, axes=1)
        points = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
        bones = np.stack([world[node] @ inverse[k] for k, node in enumerate(skin.joints)])
        shown = np.einsum("vk,vkij,vj->vi", weights, bones[joints], points)[:, :3]
        np.testing.assert_allclose(shown, wanted, atol=2e-5)  # metres


def test_vrm_looks_where_both_eyes_look_and_blinks(made: Path, tmp_path: Path) -> None:
    import pygltflib

    gltf = pygltflib.GLTF2().load_binary(str(exported(made, tmp_path, "vrm")))
    assert gltf.extensionsUsed == ["VRMC_vrm_animation"]
    vrm, moved, shown = gltf.extensions["VRMC_vrm_animation"], channels(gltf), of_rig()
    looking = gltf.nodes[vrm["lookAt"]["node"]].name
    euler = Rotation.from_quat(moved[looking, "rotation"]).as_euler("YXZ")
    mean = rotation.gaze_to_angles(shown.gaze).mean(axis=1)
    np.testing.assert_allclose(euler, np.stack([mean[:, 0], -mean[:, 1], 0 * mean[:, 0]], 1), atol=1e-3)
    head = gltf.nodes[vrm["humanoid"]["humanBones"]["head"]["node"]].name
    np.testing.assert_allclose(Rotation.from_quat(moved[head, "rotation"]).as_rotvec(), shown.head, atol=1e-6)
    blink = gltf.nodes[vrm["expressions"]["preset"]["blinkLeft"]["node"]].name
    np.testing.assert_allclose(moved[blink, "translation"][:, 0], np.maximum(shown.lid[:, 0], 0), atol=1e-6)
    assert {"hips", "leftHand", "rightFoot", "neck"} <= set(vrm["humanoid"]["humanBones"])


def test_usd_poses_the_head_like_this_package(made: Path, tmp_path: Path, vertices: np.ndarray) -> None:
    from pxr import Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.Open(str(exported(made, tmp_path, "usd")))
    assert (stage.GetTimeCodesPerSecond(), stage.GetEndTimeCode(), UsdGeom.GetStageMetersPerUnit(stage)) == (25, 74, 1)
    cache = UsdSkel.Cache()
    assert cache.Populate(UsdSkel.Root(stage.GetPrimAtPath("/Head")), Usd.PrimDefaultPredicate)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Head/Face"))
    skinning = cache.GetSkinningQuery(mesh.GetPrim())
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Head/Skeleton")))
    shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(mesh.GetPrim()))
    for frame, wanted in zip(FRAMES, vertices, strict=True):
        points = Vt.Vec3fArray(mesh.GetPointsAttr().Get())
        weights = shapes.ComputeSubShapeWeights(skeleton.GetAnimQuery().ComputeBlendShapeWeights(frame))
        offsets = shapes.ComputeBlendShapePointIndices(), shapes.ComputeSubShapePointOffsets()
        assert shapes.ComputeDeformedPoints(*weights, *offsets, points)
        assert skinning.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(frame), points, frame)
        np.testing.assert_allclose(np.array(points), wanted, atol=1e-5)  # metres


def test_vocaset_is_vertices_in_rows(made: Path, tmp_path: Path, vertices: np.ndarray) -> None:
    table = np.load(exported(made, tmp_path, "vocaset"))
    assert (table.shape, table.dtype) == ((75, 3 * 6504), np.float32)
    np.testing.assert_allclose(table[list(FRAMES)].reshape(len(FRAMES), -1, 3), vertices, atol=1e-5)


def test_bvh_turns_joints_by_matrices(made: Path, tmp_path: Path) -> None:
    text = exported(made, tmp_path, "bvh").read_text()
    rows = np.array([line.split() for line in text.split("Frame Time:")[1].splitlines()[1:]], float)
    assert rows.shape == (75, 6 + 3 * 3)
    assert float(re.findall(r"Frame Time: (\S+)", text)[0]) == pytest.approx(1 / 25)
    assert re.findall(r"(?:ROOT|JOINT) (\w+)", text) == ["head", "jaw", "left_eye", "right_eye"]

    def about(axis: int, degrees: float) -> np.ndarray:
        return Rotation.from_euler("xyz"[axis], degrees, degrees=True).as_matrix()

    shown = of_rig()
    for frame in FRAMES:
        y, x, z = rows[frame, 12:15]  # right eye
        np.testing.assert_allclose(
            about(1, y) @ about(0, x) @ about(2, z), rotation.rotvec_to_matrix(shown.gaze[frame, 1]), atol=1e-6
        )
    np.testing.assert_allclose(rows[:, :3] / 100, shown.translation, atol=1e-7)


def test_mp4_films_the_motion(tmp_path: Path) -> None:
    toy_motions.motion(seconds=0.2).save(tmp_path / "a.npz")
    convert.export(tmp_path / "a.npz", tmp_path / "a.mp4", format="mp4")
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 5


@pytest.mark.parametrize("format", ["obj", "ply"])
def test_a_mesh_is_one_frame_and_read_back(made: Path, tmp_path: Path, vertices: np.ndarray, format: str) -> None:
    head, frame = anny_head(), FRAMES[1]
    convert.export(made / "anny.npz", tmp_path / f"a.{format}", frame=frame)
    mesh = trimesh.load_mesh(tmp_path / f"a.{format}", process=False, maintain_order=True)
    np.testing.assert_allclose(mesh.vertices, vertices[1], atol=1e-7)
    np.testing.assert_array_equal(mesh.faces, head.faces)
    np.testing.assert_array_equal(mesh.visual.vertex_colors[:, :3], to_pixels(head.colours))
    assert [path.name for path in tmp_path.iterdir()] == [f"a.{format}"]
    back, shown = read_motion(tmp_path / f"a.{format}", 25.0).motion, toy_motions.motion()
    for field, tolerance in TOLERANCES["vocaset"].items():
        np.testing.assert_allclose(getattr(back, field)[0], getattr(shown, field)[frame], atol=tolerance)


def test_a_mesh_of_another_head_is_refused(tmp_path: Path) -> None:
    trimesh.creation.box().export(tmp_path / "box.ply")
    with pytest.raises(InputError, match=r"should be those of the open head \(T, 19512\), got \(1, 24\)"):
        read_motion(tmp_path / "box.ply", 25.0)
    (tmp_path / "empty.obj").write_text("# nothing\n")
    with pytest.raises(InputError, match=r"empty\.obj"):
        read_motion(tmp_path / "empty.obj", 25.0)


def test_blinks_survive_in_the_layout_of_gaussian_avatars(made: Path, tmp_path: Path) -> None:
    """Of a FLAME whose expression can shut the eyes, as the real one's can: in its expression, and read back."""
    content = flame_file.arrays()
    flame_file.write(tmp_path / "first.pkl", content)
    with_lids = load_flame(tmp_path / "first.pkl")
    for side, component in (("Left", 300), ("Right", 317)):
        content["shapedirs"][..., component] += 0.8 * with_lids.expression[with_lids.shape(f"lidBlink{side}")]
    flame_file.write(tmp_path / "flame.pkl", content)
    head = load_flame(tmp_path / "flame.pkl")
    convert.export(made / "flame.npz", tmp_path / "a.npz", format="vhap", model=tmp_path / "flame.pkl", eyes="optical")
    shown, back = toy_motions.flame_motion(), read_motion(tmp_path / "a.npz").motion
    np.testing.assert_allclose(back.lid, shown.lid, atol=1e-6)
    np.testing.assert_allclose(back.expression, shown.expression, atol=1e-5)
    with np.load(tmp_path / "a.npz") as file:
        played = np.zeros((len(shown), len(head.expression_names)))
        played[:, :100] = file["expr"]

    def opening(weights: np.ndarray) -> np.ndarray:
        face = np.tensordot(weights, head.expression, axes=1) + head.template
        names, heights = head.landmarks.names, head.landmarks.of(face)[..., 1]
        upper, lower = (
            heights[
                :, [[names.index(f"{side}_eye_{lid}_{at}") for at in ("inner", "outer")] for side in ("left", "right")]
            ]
            for lid in ("upper", "lower")
        )
        return (upper - lower).mean(axis=-1)

    lids, plain = motion_to_pose(head, shown).expression, np.zeros_like(played)
    plain[:, :100] = shown.expression
    before, after, without = opening(lids), opening(played), opening(plain)
    shut = shown.lid.max(axis=1) > 0.9
    assert shut.any()
    assert np.abs(after - before)[shut].mean() < 0.15 * np.abs(without - before)[shut].mean()


TOLERANCES = {  # tolerances of the stored quantities, in radians, metres, closure and weight; the others are lost
    "flame": dict.fromkeys(("head", "gaze", "lid", "jaw", "translation", "expression"), 1e-6),
    "vhap": dict.fromkeys(("head", "gaze", "lid", "jaw", "translation", "expression"), 1e-6),
    "diffposetalk": dict.fromkeys(("head", "gaze", "lid", "jaw", "translation"), 1e-6),
    "livelink": dict.fromkeys(("head", "gaze", "lid", "jaw", "expression"), 1e-6),
    "arkit": dict.fromkeys(("head", "gaze", "lid", "jaw", "translation", "expression"), 1e-6),
    "glb": dict.fromkeys(("head", "gaze", "lid", "jaw", "translation", "expression"), 1e-5),
    "usd": dict.fromkeys(("head", "gaze", "lid", "jaw", "translation", "expression"), 1e-5),
    "vrm": {"head": 1e-5, "gaze": float(np.radians(2.1)), "lid": 0.051},  # one direction for both eyes
    "vocaset": dict.fromkeys(("head", "gaze", "lid", "jaw", "translation", "expression"), 2e-4),
    "bvh": dict.fromkeys(("head", "gaze", "jaw", "translation"), 1e-6),
}


@pytest.mark.parametrize("format", TOLERANCES)
def test_import_is_the_inverse_of_export(made: Path, tmp_path: Path, format: str) -> None:
    source = "flame" if format in ("flame", "vhap", "diffposetalk") else "anny"
    shown = toy_motions.flame_motion() if source == "flame" else toy_motions.motion()
    fps = 25.0 if format == "vocaset" else None  # which does not store it
    back = read_motion(exported(made, tmp_path, format, source), fps).motion
    assert (back.fps, len(back)) == (25.0, len(shown))
    for field, tolerance in TOLERANCES[format].items():
        np.testing.assert_allclose(getattr(back, field), getattr(shown, field), atol=tolerance, err_msg=field)
    if "expression" in TOLERANCES[format]:
        assert back.expression_names == shown.expression_names


@pytest.mark.parametrize(
    ("format", "fps"),
    [*(("livelink", fps) for fps in (24.0, 29.97, 60.0, 240.0)), ("glb", 60.0), ("bvh", 29.97), ("usd", 24.0)],
)
def test_any_frame_rate_is_read_back(tmp_path: Path, format: str, fps: float) -> None:
    toy_motions.motion(fps, 2.2 if format == "livelink" else 0.3).save(tmp_path / "a.npz")
    out = tmp_path / f"out{convert.FORMATS[format].suffix}"
    convert.export(tmp_path / "a.npz", out, format=format)
    back = read_motion(out).motion
    assert back.fps == pytest.approx(fps, abs=2e-3)
    np.testing.assert_allclose(back.gaze, toy_motions.motion(fps, 2.2 if format == "livelink" else 0.3).gaze, atol=1e-5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"format": "fbx"}, "format: should be one of flame, vhap"),
        ({"format": "glb"}, "should be a name that ends in .glb"),
        ({"format": "flame"}, "should be your FLAME file, which maps the expression of anny to flame"),
        ({"format": "flame", "fps": 5.0}, "fps: should be 10 to 240, got 5"),
        ({"format": "vhap", "sound": "a.wav"}, "should be used with mp4 only"),
        ({"format": "glb", "frame": 3}, "frame: should be used with obj and ply only, got glb"),
    ],
)
def test_bad_input_is_one_line_error_and_writes_nothing(
    made: Path, tmp_path: Path, options: dict, message: str
) -> None:
    with pytest.raises(InputError, match=re.escape(message)) as told:
        convert.export(made / "anny.npz", tmp_path / "out.npz", **options)
    assert "\n" not in str(told.value)
    assert not list(tmp_path.iterdir())


def test_a_face_at_rest_needs_no_map(tmp_path: Path) -> None:
    made = toy_motions.motion()
    Motion.of(25.0, made.head, made.gaze, lid=made.lid).save(tmp_path / "a.npz")
    convert.export(tmp_path / "a.npz", tmp_path / "b.npz", format="vhap")
    with np.load(tmp_path / "b.npz") as file:
        assert not file["expr"].any()


@pytest.fixture(scope="module")
def flame(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with FLAME's layout."""
    path = tmp_path_factory.mktemp("flame") / "flame.pkl"
    flame_file.write(path, flame_file.arrays())
    return path


def test_faces_are_mapped_between_the_heads(made: Path, tmp_path: Path, flame: Path) -> None:
    convert.export(made / "anny.npz", tmp_path / "a.npz", format="vhap", model=flame)
    with np.load(tmp_path / "a.npz") as file:
        assert file["expr"].std() > 1e-3
    convert.export(made / "flame.npz", tmp_path / "a.json", format="arkit", model=flame)
    content = json.loads((tmp_path / "a.json").read_text())
    assert np.array(content["coefficients"])[:, content["names"].index("mouthSmileLeft")].std() > 1e-3


def test_vhap_tracks_are_rendered_on_flame(made: Path, tmp_path: Path, flame: Path) -> None:
    toy_motions.flame_motion().cut(0, 3).save(tmp_path / "a.npz")
    convert.export(tmp_path / "a.npz", tmp_path / "vhap.npz", format="vhap")
    convert.import_files([tmp_path / "vhap.npz"], tmp_path / "back.npz")
    render(tmp_path / "back.npz", tmp_path / "a.mp4", head="flame", model=flame, size=32)
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 3


def test_a_mesh_of_flame_has_its_vertices(made: Path, tmp_path: Path, flame: Path) -> None:
    shown = convert.export(made / "flame.npz", tmp_path / "a.ply", head="flame", model=flame, frame=FRAMES[1])
    mesh, head = trimesh.load_mesh(tmp_path / "a.ply", process=False), load_flame(flame)
    moved = to_forward_axes(shown, "visual")
    np.testing.assert_allclose(mesh.vertices, posed_vertices(head, motion_to_pose(head, moved))[0], atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, head.faces)


def test_a_folder_of_animate_is_imported_without_its_other_files(tmp_path: Path) -> None:
    Motion.of(25.0, np.zeros((4, 3)), np.zeros((4, 2, 3))).save(tmp_path / "sample_00.npz")
    for name in ("manifest.json", "summary.csv", "sample_00.events.json"):
        (tmp_path / name).write_text("{}")
    (read,) = convert.import_files([tmp_path], tmp_path / "out")
    assert read.name == "sample_00"
