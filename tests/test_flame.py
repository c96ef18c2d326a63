"""The FLAME file: read without chumpy and without executing code; skinning; errors for bad files."""

import os
import pickle
from dataclasses import replace
from pathlib import Path

import flame_file
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from talkingeyes.core.errors import InputError
from talkingeyes.head.flame import PUPILS, load_flame, read_flame
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import Pose, expression_shape_names
from talkingeyes.head.skinning import posed_vertices


@pytest.fixture(scope="module")
def content() -> dict[str, np.ndarray]:
    return flame_file.arrays()


@pytest.fixture(scope="module")
def path(content: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("flame") / "generic_model.pkl"
    flame_file.write(file, content)
    return file


@pytest.fixture(scope="module")
def head(path: Path) -> HeadModel:
    return load_flame(path)


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_every_array_comes_out_of_the_pickle_without_chumpy(
    content: dict[str, np.ndarray], tmp_path: Path, protocol: int
):
    small = {**content, "shapedirs": np.broadcast_to(np.float32(0.5), (5023, 3, 400))}
    if protocol == 0:  # the text protocol is slow; one array is enough, the others are tested with the binary protocols
        small = {"v_template": content["v_template"]}
    flame_file.write(tmp_path / "a.pkl", small, protocol)
    if protocol == 0:
        with pytest.raises(InputError, match="should hold shapedirs"):
            read_flame(tmp_path / "a.pkl")
        return
    file = read_flame(tmp_path / "a.pkl")
    np.testing.assert_array_equal(file.template, content["v_template"])
    np.testing.assert_allclose(file.regressor, content["J_regressor"])
    np.testing.assert_array_equal(file.faces, content["f"])
    assert file.directions.shape == (5023, 3, 400)


def reference_lbs(content: dict[str, np.ndarray], pose: np.ndarray, shape: np.ndarray, expression: np.ndarray):
    """Reference skinning as in the FLAME paper: 4 x 4 matrices along the kinematic chain; origin of the file."""
    directions = content["shapedirs"].astype(float)
    shaped = content["v_template"] + directions[..., :300] @ shape
    joints = content["J_regressor"] @ shaped
    turns = Rotation.from_rotvec(pose.reshape(5, 3)).as_matrix()
    posed_vertices = (
        shaped + directions[..., 300:] @ expression + content["posedirs"] @ (turns[1:] - np.eye(3)).reshape(36)
    )
    world = []
    for joint, parent in enumerate([-1, 0, 1, 1, 1]):
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = turns[joint], joints[joint] - (joints[parent] if parent >= 0 else 0)
        world.append(local if parent < 0 else world[parent] @ local)
    for joint in range(5):
        world[joint] = world[joint] @ np.block([[np.eye(3), -joints[joint][:, None]], [np.zeros((1, 3)), 1]])
    blend = np.einsum("vj,jab->vab", content["weights"], np.stack(world))
    return (blend @ np.c_[posed_vertices, np.ones(len(posed_vertices))][..., None])[:, :3, 0]


def test_skinning_equals_independent_implementation(content: dict[str, np.ndarray], head: HeadModel):
    rng = np.random.default_rng(1)
    pose = rng.normal(0, 0.3, 15)
    pose[:3] = 0  # the head rotates about the neck; the root is fixed
    shape, expression, moved = rng.normal(size=300), rng.normal(size=100), rng.normal(0, 0.1, 3)
    person = replace(
        head,
        template=head.template + np.tensordot(shape, head.identity, axes=1),
        joints=head.joints + np.tensordot(shape, head.identity_joints, axes=1),
    )
    weights = np.concatenate([expression, np.zeros(10)])[None]
    got = posed_vertices(
        person, Pose(weights, pose[None, 3:6], pose[None, 6:9], pose[9:].reshape(1, 2, 3), moved[None])
    )[0]
    origin = content["J_regressor"][1] @ content["v_template"]
    expected = reference_lbs(content, pose, shape, expression) - origin + moved
    np.testing.assert_allclose(got, expected, atol=1e-5)


def test_pupils_irises_and_sides_match_flame(content: dict[str, np.ndarray], head: HeadModel):
    assert tuple(head.pupils) == PUPILS == (4051, 4597)
    assert head.template[4051, 0] > 0 > head.template[4597, 0]  # the subject's left is +x
    reach = np.linalg.norm(content["v_template"][list(PUPILS)] - flame_file.EYES, axis=1)
    np.testing.assert_allclose(reach, 0.0133, atol=1e-9)
    assert head.irises.shape == (2, 32)
    for ring, centre in zip(head.irises, flame_file.EYES, strict=True):
        out = content["v_template"][ring] - centre
        np.testing.assert_allclose(np.hypot(out[:, 0], out[:, 1]), 0.0126 * np.sin(np.radians(28.2)), atol=1e-6)
    assert expression_shape_names(head) == tuple(f"expression_{number:03d}" for number in range(100))
    assert len(head.identity_names) == 300


def test_landmarks_come_from_the_embedding(path: Path, tmp_path: Path, content: dict[str, np.ndarray]):
    embedding = flame_file.write_embedding(tmp_path / "landmark_embedding.npy")
    head = load_flame(path, tmp_path / "landmark_embedding.npy")
    place = head.landmarks.names.index("left_eye_outer")  # landmark 45 of 68
    corners = content["v_template"][content["f"][embedding["full_lmk_faces_idx"][0, 45]]]
    expected = embedding["full_lmk_bary_coords"][0, 45] @ corners - content["J_regressor"][1] @ content["v_template"]
    np.testing.assert_allclose(head.landmarks.of(head.template)[place], expected)
    assert len(head.landmarks.names) == len(set(head.landmarks.names)) == 31


class Command:
    """Runs a command when it is unpickled without restrictions."""

    def __init__(self, command: str) -> None:
        self.command = command

    def __reduce__(self) -> tuple:
        return os.system, (self.command,)


class Evaluated(Command):
    def __reduce__(self) -> tuple:
        return eval, (f"__import__('os').system({self.command!r})",)


@pytest.mark.parametrize("payload", [Command, Evaluated])
def test_pickle_with_other_names_is_rejected_without_execution(payload: type[Command], tmp_path: Path):
    target = tmp_path / "made-by-the-pickle"
    file = tmp_path / "hostile.pkl"
    file.write_bytes(pickle.dumps({"v_template": payload(f"touch {target}")}))
    with pytest.raises(InputError, match="not on the list of allowed names") as refused:
        load_flame(file)
    assert "\n" not in str(refused.value)
    assert not target.exists()
    pickle.loads(file.read_bytes())  # the same bytes are executed by the unrestricted unpickler
    assert target.exists()


def test_malicious_file_cannot_use_allowed_names_to_escape(tmp_path: Path):
    """Dotted names and attributes of allowed modules are separate names, and rejected."""
    for text in (b"cnumpy\ntestsuite\n.", b"cnumpy\nload\n.", b"\x80\x04\x8c\x05numpy\x8c\x0ddtype.__new__\x93."):
        (tmp_path / "a.pkl").write_bytes(text)
        with pytest.raises(InputError, match="not on the list"):
            load_flame(tmp_path / "a.pkl")


def bad_files(content: dict[str, np.ndarray]) -> dict[str, bytes]:
    def pickled(**changes: object) -> bytes:
        return pickle.dumps({**content, **changes})

    nan = content["weights"].copy()
    nan[7, 2] = np.nan
    return {
        r"not a readable pickle of arrays \(Ran out of input\)": b"",
        "not a readable pickle of arrays": b"solid head\nfacet normal 0 0 0\n",
        "broken or not a pickle": b"cnumpy\nndarray\n)R.",
        "should be a FLAME model, a dictionary, got list": pickle.dumps([1, 2]),
        r"should hold v_template \(5023, 3\), got vertices": pickle.dumps({"vertices": 3}),
        r"shapedirs should have shape \(5023, 3, 400\), got \(6890, 3, 10\)": pickled(
            shapedirs=np.zeros((6890, 3, 10))
        ),
        "weights should be finite, got NaN": pickled(weights=nan),
        "weights should be an array of numbers": pickled(weights={"a": 1}),
        "joints should have parents": pickled(kintree_table=np.zeros((2, 5), int)),
        "faces should name vertices 0 to 5022": pickled(f=content["f"] + 100),
    }


def test_wrong_file_is_one_line_error(content: dict[str, np.ndarray], tmp_path: Path):
    small = {**content, "shapedirs": np.zeros((5023, 3, 400), np.float16)}
    for says, raw in bad_files(small).items():
        (tmp_path / "model.pkl").write_bytes(raw)
        with pytest.raises(InputError, match=says) as refused:
            load_flame(tmp_path / "model.pkl")
        assert "\n" not in str(refused.value)


def test_truncated_file_is_one_line_error(path: Path, tmp_path: Path):
    raw = path.read_bytes()
    for keep in (10, 3_000, len(raw) // 2, len(raw) - 1):
        (tmp_path / "cut.pkl").write_bytes(raw[:keep])
        with pytest.raises(InputError) as refused:
            load_flame(tmp_path / "cut.pkl")
        assert "\n" not in str(refused.value)


def test_missing_or_wrong_embedding_is_one_line_error(path: Path, tmp_path: Path):
    with pytest.raises(InputError, match="no such file"):
        load_flame(tmp_path / "none.pkl")
    wrong = tmp_path / "embedding.npy"
    np.save(wrong, np.zeros(3))
    with pytest.raises(InputError, match="an array of objects"):
        load_flame(path, wrong)
    np.save(wrong, np.array({"a": 1}, dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="full_lmk_faces_idx"):
        load_flame(path, wrong)
    wrong.write_text("<html>")
    with pytest.raises(InputError, match="not a readable landmark embedding"):
        load_flame(path, wrong)
