"""Readers of other formats, on files written here in their layouts and on real face tracker tables where available."""

from __future__ import annotations

import io
import pickle
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
import toy_motions
from command_line import call

from talkingeyes.animation.line_of_sight import from_forward_axes
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.motion_files import read_motions
from talkingeyes.formats import arkit
from talkingeyes.formats.readers.key_map import load_key_map
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.formats.rotations import compose_rotations
from talkingeyes.formats.writers.bvh import write_bvh
from talkingeyes.formats.writers.vrm import write_vrm
from talkingeyes.head.anny import anny_head
from talkingeyes.workflows.convert import export, import_files

REAL = Path(__file__).parents[2] / "shared" / "data" / "real" / "gaze"
RANDOM = np.random.default_rng(0)


def small(*shape: int, size: float = 0.1) -> np.ndarray:
    return RANDOM.normal(0, size, shape)


def test_vhap_joins_head_and_neck_and_has_the_left_eye_first(tmp_path: Path) -> None:
    parts = {"rotation": small(9, 3), "neck_pose": small(9, 3), "jaw_pose": small(9, 3), "eyes_pose": small(9, 6)}
    others = {"expr": small(9, 100), "shape": small(300), "translation": small(9, 3), "timestep_id": np.arange(9)}
    np.savez(tmp_path / "a.npz", **{name: array.astype(np.float32) for name, array in (parts | others).items()})
    motion = read_motion(tmp_path / "a.npz", 25.0, eyes="optical").motion
    np.testing.assert_allclose(motion.head, compose_rotations(parts["rotation"], parts["neck_pose"]), atol=1e-6)
    np.testing.assert_allclose(motion.gaze[:, 0], parts["eyes_pose"][:, :3], atol=1e-6)
    assert motion.expression.shape == (9, 100)
    with pytest.raises(InputError, match="frame rate, got none; set --fps"):
        read_motion(tmp_path / "a.npz")


def test_vhap_of_one_frame_is_a_motion(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", rotation=small(1, 3), jaw_pose=small(1, 3), eyes_pose=small(1, 6), expr=small(1, 100))
    assert len(read_motion(tmp_path / "a.npz", 25.0).motion) == 1


FLAME_PARTS = {"rotation": 3, "neck_pose": 3, "jaw_pose": 3, "eyes_pose": 6, "translation": 3, "expr": 100}


def frames(folder: Path, name: str, numbers: list[int], flat: bool = False) -> dict[str, np.ndarray]:
    """A folder with an npz for each number, as GaussianAvatars and VHAP have them, and its rows."""
    folder.mkdir()
    rows = {part: small(len(numbers), width).astype(np.float32) for part, width in FLAME_PARTS.items()}
    for k, number in enumerate(numbers):
        parts = {part: row[k] if flat else row[k : k + 1] for part, row in rows.items()}
        np.savez(folder / name.format(number), shape=small(300), static_offset=small(1, 50, 3), **parts)
    return rows


@pytest.mark.parametrize(("name", "flat"), [("{:05d}.npz", False), ("{}.npz", True), ("frame_{:04d}_cam01.npz", False)])
def test_a_folder_of_numbered_frames_is_one_motion(tmp_path: Path, name: str, flat: bool) -> None:
    rows = frames(tmp_path / "flame_param", name, list(range(12)), flat)
    read = read_motion(tmp_path / "flame_param", 25.0, eyes="optical")
    motion = read.motion
    assert read.notes[0] == "2 of 8 arrays have no place here: shape, static_offset"
    np.testing.assert_allclose(motion.head, compose_rotations(rows["rotation"], rows["neck_pose"]), atol=1e-6)
    np.testing.assert_array_equal(motion.gaze.reshape(-1, 6), rows["eyes_pose"])
    np.testing.assert_array_equal(motion.expression, rows["expr"])
    assert motion.valid.all()
    with pytest.raises(InputError, match="frame rate, got none; set --fps"):
        read_motion(tmp_path / "flame_param")


def test_other_files_among_frames_are_noted(tmp_path: Path) -> None:
    frames(tmp_path / "flame_param", "{:05d}.npz", list(range(4)))
    np.savez(tmp_path / "flame_param" / "canonical_flame_param.npz", expr=small(1, 100))
    read = read_motion(tmp_path / "flame_param", 25.0)
    assert len(read.motion) == 4
    assert read.notes[1] == "1 of 5 files has no place here: canonical_flame_param.npz"


def test_frames_that_are_missing_are_not_valid(tmp_path: Path) -> None:
    rows = frames(tmp_path / "tenths", "{:05d}.npz", [100, 110, 140, 150])
    motion = read_motion(tmp_path / "tenths", 25.0).motion
    assert list(motion.valid) == [True, True, False, False, True, True]
    np.testing.assert_allclose(motion.jaw[3], rows["jaw_pose"][1] / 3 + rows["jaw_pose"][2] * 2 / 3, atol=1e-6)
    np.savez(tmp_path / "tenths" / "00160.npz", jaw_pose=small(2, 3))
    with pytest.raises(InputError, match=r"00160\.npz: should hold one frame of \w+, as the first file does, got [02]"):
        read_motion(tmp_path / "tenths", 25.0)
    np.savez(tmp_path / "tenths" / "9999999999.npz", jaw_pose=small(1, 3))
    with pytest.raises(InputError, match="at most 1,000,000 frames"):
        read_motion(tmp_path / "tenths", 25.0)


def test_import_tells_frames_from_motions(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    frames(tmp_path / "frames", "{:05d}.npz", list(range(30)))
    (tmp_path / "motions").mkdir()
    for number in range(2):
        np.savez(tmp_path / "motions" / f"take_{number}.npz", jaw_pose=small(30, 3), fps=30.0)
    for folder, names in (("frames", ["frames"]), ("motions", ["take_0", "take_1"])):
        out = tmp_path / f"{folder}_out"
        assert call("import", str(tmp_path / folder), "-o", str(out), "--fps", "30") == 0
        assert capfd.readouterr().out.splitlines() == [f"{name}: flame, 1.00 s at 30 fps" for name in names]
        assert sorted(path.stem for path in out.iterdir()) == names
    with pytest.raises(InputError, match="`talkingeyes import` converts files of others"):
        list(read_motions(tmp_path / "frames" / "00000.npz"))


def test_conversion_never_overwrites_its_input(tmp_path: Path) -> None:
    motions = tmp_path / "motions"
    motions.mkdir()
    np.savez(motions / "a.npz", jaw_pose=small(30, 3), fps=30.0)
    with pytest.raises(InputError, match=r"should be another folder than that of the input$"):
        import_files([motions], motions, force=True)
    with pytest.raises(InputError, match=r"should be another file than the input$"):
        import_files([motions], motions / "a.npz", force=True)
    toy_motions.motion().save(tmp_path / "m.npz")
    with pytest.raises(InputError, match=r"should be another file than the input$"):
        export(tmp_path / "m.npz", tmp_path / "m.npz", format="flame", force=True)


def test_diffposetalk_has_head_and_jaw_in_its_pose(tmp_path: Path) -> None:
    pose = small(9, 6)
    np.savez(tmp_path / "a.npz", shape=small(100), exp=small(9, 50), pose=pose)
    read = read_motion(tmp_path / "a.npz", 25.0)
    np.testing.assert_allclose(np.hstack([read.motion.head, read.motion.jaw]), pose, atol=1e-7)
    assert read.notes == (
        "1 of 3 arrays has no place here: shape",
        "no gaze in the file: the eyes look straight ahead",
    )


@pytest.mark.parametrize(("width", "name"), [(53, "emote"), (403, "probtalk3d"), (106, "artalk"), (108, "unils")])
def test_arrays_are_recognised_by_width(tmp_path: Path, width: int, name: str) -> None:
    rows = small(9, width)
    np.save(tmp_path / f"{name}.npy", rows[None] if width == 403 else rows)
    motion = read_motion(tmp_path / f"{name}.npy", 25.0, eyes="optical").motion
    jaw = {53: rows[:, 50:], 403: rows[:, 400:], 106: rows[:, 103:], 108: np.pad(rows[:, 103:104], ((0, 0), (0, 2)))}
    np.testing.assert_allclose(motion.jaw, jaw[width])
    first = rows[:, 300] if width == 403 else rows[:, 0]
    np.testing.assert_allclose(motion.expression[:, 0], first)
    if width > 53 and width != 403:
        np.testing.assert_allclose(motion.head, rows[:, 100:103], atol=1e-9)
    if width == 108:
        np.testing.assert_allclose(motion.gaze[:, 1], np.pad(rows[:, 106:108], ((0, 0), (0, 1))))


def test_artalk_is_read_from_a_torch_file_without_running_it(tmp_path: Path) -> None:
    import torch

    rows = small(9, 106).astype(np.float32)
    torch.save(torch.from_numpy(rows), tmp_path / "a.pt")
    np.testing.assert_allclose(read_motion(tmp_path / "a.pt", 25.0).motion.jaw, rows[:, 103:], atol=1e-7)


class Hostile:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        import os

        return os.system, ("touch /tmp/never",)


def test_torch_file_with_code_is_rejected(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps(Hostile()))
    with pytest.raises(InputError, match="which is not on the list of allowed names"):
        read_motion(tmp_path / "a.pt", 25.0)


def test_tensor_beyond_its_storage_is_rejected(tmp_path: Path) -> None:
    import torch

    content = io.BytesIO()
    torch.save(torch.zeros(9, 106), content)
    with zipfile.ZipFile(content) as good, zipfile.ZipFile(tmp_path / "a.pt", "w") as bad:
        for name in good.namelist():
            bad.writestr(name, good.read(name)[: 40 if "/data/" in name else None])
    with pytest.raises(InputError, match="broken or not a pickle"):
        read_motion(tmp_path / "a.pt", 25.0)


def test_metrical_tracker_turns_its_camera(tmp_path: Path) -> None:
    import torch

    head, eyes, jaw = small(5, 3), small(5, 2, 3), small(5, 3)
    for frame in range(5):
        six = {
            name: rotation.rotvec_to_matrix(vectors[frame]).reshape(-1, 3, 3)[:, :2].reshape(1, -1)
            for name, vectors in {"eyes": eyes, "jaw": jaw}.items()
        }
        flame = {**six, "exp": np.zeros((1, 100)), "shape": np.zeros((1, 300)), "eyelids": np.full((1, 2), 0.25)}
        opencv = {
            "R": (np.diag([1, -1, -1]) @ rotation.rotvec_to_matrix(head[frame]))[None],
            "t": np.array([[0.1, 0, 1.0]]),
        }
        torch.save(
            {"flame": flame, "opencv": opencv, "img_size": np.array([512, 512]), "frame_id": frame},
            tmp_path / f"{frame:05d}.frame",
        )
    motion = read_motion(tmp_path, 25.0).motion
    np.testing.assert_allclose(motion.head, head, atol=1e-9)
    np.testing.assert_allclose(motion.gaze, eyes, atol=1e-9)
    np.testing.assert_allclose(motion.jaw, jaw, atol=1e-9)
    assert (motion.lid == 0.25).all()
    assert not motion.translation.any()


def openface(path: Path, vectors: bool) -> np.ndarray:
    """A table with gaze 10 degrees to the subject's left, eyes converged by 4, head turned 20 to the left."""
    yaw = np.radians([12.0 - 4.0, 12.0])  # left eye, right eye, in space
    columns = {"frame": np.arange(1, 6), "timestamp": np.arange(5) / 30, "confidence": np.full(5, 0.98)}
    columns |= {"success": np.ones(5), "gaze_angle_x": np.full(5, yaw.mean()), "gaze_angle_y": np.zeros(5)}
    columns |= {"pose_Rx": np.zeros(5), "pose_Ry": np.full(5, -np.radians(20)), "pose_Rz": np.zeros(5)}
    columns |= {"AU45_r": np.array([0, 0, 5.0, 0, 0])}
    if vectors:  # eye 0 is on the left of the picture, the subject's right; z points away from the camera
        for eye, angle in ((0, yaw[1]), (1, yaw[0])):
            columns |= {f"gaze_{eye}_x": np.full(5, np.sin(angle)), f"gaze_{eye}_y": np.zeros(5)}
            columns |= {f"gaze_{eye}_z": np.full(5, -np.cos(angle))}
    rows = [", ".join(columns), *(", ".join(f"{v:.9g}" for v in row) for row in np.array(list(columns.values())).T)]
    path.write_text("\n".join(rows))
    return np.asarray(yaw)


@pytest.mark.parametrize("vectors", [True, False])
def test_openface_counts_eyes_in_the_picture(tmp_path: Path, vectors: bool) -> None:
    yaw = openface(tmp_path / "a.csv", vectors)
    motion = read_motion(tmp_path / "a.csv").motion
    space = rotation.gaze_in_space(motion.head, motion.gaze)[0, :, 0]
    np.testing.assert_allclose(space, yaw if vectors else yaw.mean(), atol=1e-6)
    np.testing.assert_allclose(rotation.gaze_to_angles(motion.head)[0], [np.radians(20), 0], atol=1e-6)
    assert motion.fps == pytest.approx(30.0)
    assert motion.lid[2].tolist() == [1.0, 1.0]


def test_openface_frames_that_are_missing_are_not_valid(tmp_path: Path) -> None:
    openface(tmp_path / "a.csv", True)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "a.csv").write_text("\n".join(lines[:3] + lines[4:]))
    motion = read_motion(tmp_path / "a.csv").motion
    assert motion.valid.tolist() == [True, True, False, True, True]
    assert motion.fps == pytest.approx(30.0, abs=1e-3)


def test_live_link_headers_and_time_gaps(tmp_path: Path) -> None:
    """Variants in other recordings: order of columns, capital letters, a missing frame, a time of day."""
    made = toy_motions.motion(60.0, 2.5)
    conversion_rows(made, tmp_path / "a.csv")
    lines = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    order = [0, 1, *np.random.default_rng(1).permutation(np.arange(2, len(lines[0])))]
    lines[0][1] = "BlendshapeCount"
    for row in lines[1:]:
        row[0] = "18:48:" + row[0][6:]
    del lines[40]
    (tmp_path / "a.csv").write_text("\n".join(",".join(line[k] for k in order) for line in lines))
    motion = read_motion(tmp_path / "a.csv", eyes="optical").motion
    assert (motion.fps, len(motion)) == (60.0, len(made))
    kept = np.arange(len(made)) != 39
    np.testing.assert_allclose(motion.gaze[kept], made.gaze[kept], atol=1e-6)
    np.testing.assert_allclose(motion.expression[kept], made.expression[kept], atol=1e-6)


@pytest.mark.parametrize(("factor", "zero"), [(-1.0, False), (180 / np.pi, False), (1.0, True)])
def test_live_link_angles_agree_with_look_shapes(tmp_path: Path, factor: float, zero: bool) -> None:
    """Other programs write the opposite sign, degrees, or zeros."""
    made = toy_motions.motion(60.0, 2.5)
    conversion_rows(made, tmp_path / "a.csv")
    lines = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    for row in lines[1:]:
        for name in ("LeftEyeYaw", "LeftEyePitch", "LeftEyeRoll", "RightEyeYaw", "RightEyePitch", "RightEyeRoll"):
            place = lines[0].index(name)
            row[place] = "0" if zero or "Roll" in name else f"{factor * float(row[place]):.9f}"
    (tmp_path / "a.csv").write_text("\n".join(map(",".join, lines)))
    found = rotation.gaze_to_angles(read_motion(tmp_path / "a.csv", eyes="optical").motion.gaze)
    np.testing.assert_allclose(found, rotation.gaze_to_angles(made.gaze), atol=1e-5)


def conversion_rows(made: Motion, path: Path) -> None:
    from talkingeyes.formats.writers.arkit import write_live_link

    write_live_link(made, path)


TKED = """
fps: 25
head_model: flame
head: {columns: [0, 3]}
gaze: {columns: [3, 9]}
"""
DEGREES = """
fps: {key: rate}
head: {key: pose, rotation_format: euler_YXZ, unit: degrees, axis_signs: [1, 1, 1]}
gaze: {key: eyes, rotation_format: yaw_pitch, unit: degrees, eyes: right_left, frame: space}
translation: {key: place, scale: 0.001}
lid: {key: shut, eyes: right_left}
"""


def test_a_map_places_the_columns_of_one_array(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(TKED)
    rows = small(9, 9)
    np.save(tmp_path / "a.npy", rows)
    motion = read_motion(tmp_path / "a.npy", None, load_key_map(tmp_path / "map.yaml")).motion
    np.testing.assert_allclose(motion.head, rows[:, :3])
    np.testing.assert_allclose(motion.gaze.reshape(9, 6), rows[:, 3:])


def test_map_converts_units_eyes_and_gaze_in_space(tmp_path: Path) -> None:
    made = toy_motions.motion()
    space = np.degrees(rotation.gaze_in_space(made.head, made.gaze))
    euler_yxz = np.degrees(rotation_turns(made.head))
    np.savez(
        tmp_path / "a.npz",
        rate=25.0,
        pose=euler_yxz,
        eyes=space[:, ::-1].reshape(-1, 4),
        place=1000 * made.translation,
        shut=made.lid[:, ::-1],
    )
    (tmp_path / "map.yaml").write_text(DEGREES)
    motion = read_motion(tmp_path / "a.npz", None, load_key_map(tmp_path / "map.yaml")).motion
    for field in ("head", "gaze", "translation", "lid"):
        np.testing.assert_allclose(getattr(motion, field), getattr(made, field), atol=1e-9, err_msg=field)


def rotation_turns(vectors: np.ndarray) -> np.ndarray:
    from talkingeyes.formats.rotations import euler_yxz

    return euler_yxz(vectors)


def test_axes_of_a_map_may_be_mirrored(tmp_path: Path) -> None:
    """With x to the right, a rotation to the left has the opposite sign; one downwards does not."""
    (tmp_path / "map.yaml").write_text("fps: 25\nhead: {key: h, axis_signs: [-1, 1, 1]}\n")
    np.savez(tmp_path / "a.npz", h=np.tile([[0.1, -0.2, -0.3]], (4, 1)))
    motion = read_motion(tmp_path / "a.npz", None, load_key_map(tmp_path / "map.yaml")).motion
    np.testing.assert_allclose(motion.head[0], [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fps: 25\nhaed: {}", "map.yaml: haed: Extra inputs are not permitted"),
        ("fps: 25\nhead: {unit: turns}", "map.yaml: head.unit: Input should be 'radians' or 'degrees', got 'turns'"),
        ("fps: 25\nhead: {rotation_format: spin}", "rotation_format: should be one of rotation_vector"),
        ("fps: 25\nhead: {columns: [0, 4]}", "head should have 3 columns"),
        ("fps: 25\nhead: {columns: [8, 12]}", "columns of head should lie in 0 to 9"),
        ("head: {columns: [0, 3]}", "set --fps, or fps in the map"),
        ("fps: 25\nhead: {columns: [0, 3]}\ngaze: {columns: [0, 5]}", "should have 3 or 6 columns, got 5"),
        ("fps: 25", "should contain head or gaze"),
        ("fps: [", "not a readable map"),
    ],
)
def test_mismatched_map_is_one_line_error(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "map.yaml").write_text(text)
    np.save(tmp_path / "a.npy", small(9, 9))
    with pytest.raises(InputError, match=re.escape(message)) as told:
        read_motion(tmp_path / "a.npy", None, load_key_map(tmp_path / "map.yaml"))
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(("head", "eyes"), [("mixamorig:{}", "mixamorig:{}Eye"), ("CC_Base_{}", "CC_Base_{}_Eye")])
def test_joints_of_bvh_have_the_names_of_rigs(tmp_path: Path, head: str, eyes: str) -> None:
    made = toy_motions.motion(30.0)
    write_bvh(made, anny_head(), tmp_path / "a.bvh")
    text = (tmp_path / "a.bvh").read_text()
    text = text.replace("ROOT head", f"ROOT {head.format('Head')}").replace("0.033333333", "0.033333")
    for side in ("Left", "Right"):
        text = text.replace(f"JOINT {side.lower()}_eye", f"JOINT {eyes.format(side)}")
    (tmp_path / "a.bvh").write_text(text)
    read = read_motion(tmp_path / "a.bvh", eyes="optical")
    assert read.motion.fps == 30.0
    np.testing.assert_allclose(read.motion.head, made.head, atol=1e-6)
    np.testing.assert_allclose(read.motion.gaze, made.gaze, atol=1e-6)
    assert not [note for note in read.notes if "place" in note]


def test_the_head_of_bvh_turns_with_its_neck(tmp_path: Path) -> None:
    channels = "OFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation"
    tree = f"HIERARCHY\nROOT Neck\n{{\n{channels}\nJOINT Head\n{{\n{channels}\nEnd Site\n{{\nOFFSET 0 1 0\n}}\n}}\n}}\n"
    (tmp_path / "a.bvh").write_text(f"{tree}MOTION\nFrames: 2\nFrame Time: 0.04\n0 0 0 0 0 0\n0 0 10 0 0 5\n")
    motion = read_motion(tmp_path / "a.bvh").motion
    np.testing.assert_allclose(np.degrees(motion.head[1]), [0, 15, 0], atol=1e-9)


def test_broken_files_are_one_line_errors(tmp_path: Path) -> None:
    made = toy_motions.motion()
    np.save(tmp_path / "zero.npy", np.zeros((9, 4)))
    (tmp_path / "map.yaml").write_text("fps: 25\nhead: {rotation_format: quaternion_xyzw}\n")
    with pytest.raises(InputError, match=r"zero\.npy: not readable as map"):
        read_motion(tmp_path / "zero.npy", None, load_key_map(tmp_path / "map.yaml"))
    np.savez(tmp_path / "nan.npz", rotation=np.full((9, 3), np.nan), expr=np.zeros((9, 100)))
    with pytest.raises(InputError, match=r"nan\.npz: .*NaN"):
        read_motion(tmp_path / "nan.npz", 25.0)
    write_bvh(made, anny_head(), tmp_path / "cut.bvh")
    (tmp_path / "cut.bvh").write_text((tmp_path / "cut.bvh").read_text()[:-30])
    with pytest.raises(InputError, match=r"cut\.bvh: not a readable BVH"):
        read_motion(tmp_path / "cut.bvh")
    write_vrm(made, tmp_path / "cut.vrma")
    (tmp_path / "cut.vrma").write_bytes((tmp_path / "cut.vrma").read_bytes()[:-2000])
    with pytest.raises(InputError, match=r"cut\.vrma: not a readable GLB with an animation"):
        read_motion(tmp_path / "cut.vrma")
    (tmp_path / "half.npz").write_bytes((tmp_path / "nan.npz").read_bytes()[:300])
    with pytest.raises(InputError, match=r"half\.npz: not a readable npz"):
        read_motion(tmp_path / "half.npz", 25.0)


def test_degrees_instead_of_radians_are_an_error(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", eyes_pose=small(50, 6, size=10.0), expr=small(50, 100), rotation=small(50, 3))
    with pytest.raises(InputError, match=r"gaze should rotate by at most 1\.4 radians, got .*; if these are degrees"):
        read_motion(tmp_path / "a.npz", 25.0)


def test_implausible_eyes_are_noted(tmp_path: Path) -> None:
    eyes = np.tile([[0.0, 0.2, 0.0, 0.0, -0.2, 0.0]], (50, 1))
    np.savez(tmp_path / "a.npz", eyes_pose=eyes, expr=small(50, 100), rotation=small(50, 3))
    assert "left eye looks 22.9 degrees left of the right one" in read_motion(tmp_path / "a.npz", 25.0).notes[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.csv", "-o", "a.npz"], "none.csv: no such file"),
        (["text.csv", "-o", "a.npz"], "should have shapes of a face (EyeLookInLeft"),
        (["text.xyz", "-o", "a.npz"], "should end in one of .npz"),
        (["text.glb", "-o", "a.npz"], "should be a binary glTF"),
        (["text.usda", "-o", "a.npz"], "not a readable USD stage"),
        (["text.bvh", "-o", "a.npz"], "not a readable BVH"),
        (["text.json", "-o", "a.npz"], "not a readable JSON with fps"),
        (["text.npz", "-o", "a.npz"], "not a readable npz"),
        (["text.npy", "-o", "a.npz"], "not a readable npy"),
        (["text.pt", "-o", "a.npz"], "not a readable file saved by torch"),
        (["text.csv", "other.json", "-o", "a.npz"], "should be a folder for 2 files"),
        (["text.csv", "text.json", "-o", "out"], "another file is called text too"),
        (["text.csv", "-o", "out", "--fps", "0"], "fps: should be 1 to 1000, got 0"),
        (["empty", "-o", "out"], "should hold files that end in"),
    ],
)
def test_bad_input_is_one_line_error_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    for suffix in ("csv", "xyz", "glb", "usda", "bvh", "json", "npz", "npy", "pt"):
        (tmp_path / f"text.{suffix}").write_text("some text" if suffix != "csv" else "a,b\n1,2\n")
    before = sorted(tmp_path.rglob("*"))
    assert call("import", *words) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert message in lines[0]
    assert sorted(tmp_path.rglob("*")) == before


def test_imported_folder_is_readable_by_evaluate(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    for name in ("one", "two"):
        conversion_rows(toy_motions.motion(60.0, 2.5), tmp_path / "in" / f"{name}.csv")
    assert call("import", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--no-expression") == 0
    told = capfd.readouterr()
    assert "one: livelink, 2.50 s at 60 fps" in told.out
    assert "two: note: eyes taken as lines of sight (--eyes visual); optical axes by the mean kappa, 4.5 de" in told.err
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["one.npz", "two.npz"]
    (found,) = read_motions(tmp_path / "out" / "one.npz")
    shown = from_forward_axes(toy_motions.motion(60.0, 2.5), "visual")
    np.testing.assert_allclose(found.fields["gaze"], shown.gaze, atol=1e-6)
    assert Motion.load(tmp_path / "out" / "two.npz").expression_names == ()


@pytest.mark.skipif(not REAL.is_dir(), reason="no real recordings here")
def test_real_tables_of_trackers_become_motions(tmp_path: Path) -> None:
    for path in sorted(REAL.glob("openface_*.csv.gz")):
        motion = read_motion(path).motion
        space = rotation.cyclopean_gaze(rotation.gaze_in_space(motion.head, motion.gaze))
        assert 20 < motion.fps < 61
        assert 3 < np.degrees(space[motion.valid].std(axis=0)).max() < 30
    read = read_motion(REAL / "openface_head_test.csv.gz").motion
    yaw = rotation.gaze_to_angles(read.head)[:, 0]
    look = rotation.gaze_to_angles(read.gaze).mean(axis=1)
    assert np.corrcoef(yaw, look[:, 0])[0, 1] < -0.3  # gaze stays on the camera while the head turns
    for path in sorted(REAL.glob("pyfeat_*.csv.gz")):
        motion = read_motion(path, 29.97).motion
        assert motion.fps == pytest.approx(29.97 / 2)
        assert motion.expression_names == arkit.EXPRESSION
        assert motion.lid.max() > 0.5
