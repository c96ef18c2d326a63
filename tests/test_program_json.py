"""JSON in the layouts of other programs: Azure's visemes, MediaPipe's results, TalkingHead's animation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toy_motions
from face_files import A2F_NAMES, weights

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.editors.channels import AddedEyes
from talkingeyes.formats.editors.face_file import open_face_file
from talkingeyes.formats.readers.read_motion import read_motion

FRAMES = 45
TABLE = weights(FRAMES, len(arkit.NAMES)).round(6)
COLUMNS = dict(zip(arkit.NAMES, TABLE.T.tolist(), strict=True))
ROLL = np.linspace(-0.2, 0.2, FRAMES).round(6)


def named(row: np.ndarray) -> dict[str, float]:
    return dict(zip(arkit.NAMES, row.tolist(), strict=True))


def categories(row: np.ndarray, name: str = "categoryName") -> list[dict[str, Any]]:
    """MediaPipe's categories, in its order, with its neutral one."""
    scores = {"_neutral": 1e-5, **dict(sorted(named(row).items()))}
    return [{"index": k, "score": score, name: each} for k, (each, score) in enumerate(scores.items())]


def azure(start: int = 0, stop: int = FRAMES) -> dict[str, Any]:
    rows = np.hstack([TABLE, ROLL[:, None], np.zeros((FRAMES, 2))])
    return {"FrameIndex": start, "BlendShapes": rows[start:stop].tolist()}


def matrix(turn: np.ndarray, place: list[float]) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = rotation.rotvec_to_matrix(turn), place
    return whole


def javascript_results() -> list[dict[str, Any]]:
    """Results of MediaPipe's face landmarker as the browser has them."""
    return [
        {
            "timestamp": round(1000 * k / 30, 3),
            "faceLandmarks": [[{"x": 0.5, "y": 0.5, "z": 0.0}]],
            "faceBlendshapes": [{"categories": categories(row), "headIndex": -1, "headName": ""}],
            "facialTransformationMatrixes": [
                {"rows": 4, "columns": 4, "data": matrix(head(k), [1.0, 2.0, -40.0]).T.ravel().tolist()}
            ],
        }
        for k, row in enumerate(TABLE)
    ]


def head(k: int) -> np.ndarray:
    return np.array([0.1, 0.01 * k, 0.0])


LAYOUTS: dict[str, tuple[Any, float]] = {
    "Azure": (azure(), 60.0),
    "Azure in chunks": ([azure(30), azure(0, 30)], 60.0),
    "Azure in events": ([{"audioOffset": 1, "animation": json.dumps(azure(k, k + 15))} for k in (0, 15, 30)], 60.0),
    "Azure under a key": ({"text": "hi", "visemes": [azure(0, 30), azure(30)]}, 60.0),
    "Azure in small letters": ({"frameIndex": 0, "blendShapes": azure()["BlendShapes"]}, 60.0),
    "MediaPipe in a browser": (javascript_results(), 30.0),
    "MediaPipe in Python": (
        {"fps": 30, "results": [{"face_blendshapes": [categories(row, "category_name")]} for row in TABLE]},
        30.0,
    ),
    "MediaPipe, a list a frame": (
        {
            "metadata": {"fps": 25.0},
            "frames": [{"frame": k, "blendshapes": categories(r)} for k, r in enumerate(TABLE)],
        },
        25.0,
    ),
    "names a frame": ([{"time": k / 24, "blendShapes": named(row)} for k, row in enumerate(TABLE)], 24.0),
    "frames of names": ([{"timestamp_ms": round(1e3 * k / 60), **named(r)} for k, r in enumerate(TABLE)], 60.0),
    "frames inside of results": ([{"t": k / 50, "result": {"weights": named(r)}} for k, r in enumerate(TABLE)], 50.0),
    "faces": ([{"faces": [{"blendshapes": named(r)}], "timestamp": f"{40 * k}"} for k, r in enumerate(TABLE)], 25.0),
    "TalkingHead": (
        {"name": "blendshapes", "dt": [1000 / 30] * FRAMES, "vs": COLUMNS},
        30.0,
    ),
    "TalkingHead with times": (
        {"anim": {"vt": [40.0 * k for k in range(FRAMES)], "vs": COLUMNS}},
        25.0,
    ),
    "a list a shape": ({"frameRate": 48, **COLUMNS}, 48.0),
    "names and rows": ({"blendShapeNames": list(arkit.NAMES), "fps": 30, "data": TABLE.tolist()}, 30.0),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_is_read_and_edited(tmp_path: Path, layout: str) -> None:
    content, fps = LAYOUTS[layout]
    path = tmp_path / "a.json"
    path.write_text(json.dumps(content))
    motion = read_motion(path, eyes="optical").motion
    wanted = arkit.decoded(TABLE)
    assert motion.fps == pytest.approx(fps)
    assert motion.valid.all()
    for field in ("gaze", "lid", "jaw", "expression"):
        np.testing.assert_allclose(getattr(motion, field), getattr(wanted, field), atol=1e-9, err_msg=field)
    if layout == "Azure in events":  # whose numbers are inside of texts
        with pytest.raises(InputError, match="should be numbers of the JSON itself"):
            edited(path)
        return
    made = toy_motions.motion(fps, FRAMES / fps)
    old, new = path.read_text(), edited(path, made).decode()
    path.write_text(new)
    changed = read_motion(path, eyes="optical").motion
    np.testing.assert_allclose(changed.lid, made.lid, atol=1e-6)
    np.testing.assert_array_equal(changed.expression[:, 4:], motion.expression[:, 4:])
    assert [old.count(sign) for sign in ',:"[{'] == [new.count(sign) for sign in ',:"[{']


def edited(path: Path, made: Motion | None = None) -> bytes:
    file = open_face_file(path)
    motion = toy_motions.motion(file.motion.fps, len(file.motion) / file.motion.fps) if made is None else made
    return file.editor.edited(AddedEyes(motion, True, 1.0))


def test_azure_turns_the_head_to_the_shoulder(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(azure()))
    motion = read_motion(tmp_path / "a.json").motion
    np.testing.assert_allclose(motion.head, np.stack([0 * ROLL, 0 * ROLL, ROLL], axis=1), atol=1e-9)


def test_mediapipe_turns_the_head_by_its_matrix(tmp_path: Path) -> None:
    wanted = np.stack([head(k) for k in range(FRAMES)])
    (tmp_path / "a.json").write_text(json.dumps(javascript_results()))
    np.testing.assert_allclose(read_motion(tmp_path / "a.json").motion.head, wanted, atol=1e-9)
    by_rows = [
        {
            "faceBlendshapes": [categories(row)],
            "facial_transformation_matrixes": [matrix(head(k), [0, 1, -30]).tolist()],
        }
        for k, row in enumerate(TABLE)
    ]
    (tmp_path / "b.json").write_text(json.dumps(by_rows))
    np.testing.assert_allclose(read_motion(tmp_path / "b.json", 30.0).motion.head, wanted, atol=1e-9)


@pytest.mark.parametrize("lost", [[], None])
def test_mediapipe_may_lose_the_face(tmp_path: Path, lost: list[Any] | None) -> None:
    frames = javascript_results()
    for frame in frames[10:15]:
        frame["faceBlendshapes"] = frame["facialTransformationMatrixes"] = lost
    path = tmp_path / "a.jsonl"
    path.write_text("\n".join(map(json.dumps, frames)) + "\n")
    motion = read_motion(path).motion
    assert np.flatnonzero(~motion.valid).tolist() == [*range(10, 15)]
    before, after = path.read_text().splitlines(), edited(path).decode().splitlines()
    assert before[10:15] == after[10:15]
    assert before[15] != after[15]


def test_frames_that_are_left_out_are_gaps(tmp_path: Path) -> None:
    frames = javascript_results()
    path = tmp_path / "a.json"
    path.write_text(json.dumps(frames[:10] + frames[20:]))
    motion = read_motion(path).motion
    assert (len(motion), motion.fps) == (FRAMES, 30.0)
    assert np.flatnonzero(~motion.valid).tolist() == [*range(10, 20)]
    made = toy_motions.motion(30.0, 1.5)
    path.write_bytes(edited(path, made))
    np.testing.assert_allclose(read_motion(path, eyes="optical").motion.lid[30], made.lid[30], atol=1e-6)


def test_audio2face_has_its_own_names_of_eyes(tmp_path: Path) -> None:
    made = toy_motions.motion(30.0, 1.5)
    content = {"exportFps": 30, "facsNames": A2F_NAMES, "weightMat": weights(FRAMES, len(A2F_NAMES)).tolist()}
    (tmp_path / "a.json").write_text(json.dumps(content))
    (tmp_path / "a.json").write_bytes(edited(tmp_path / "a.json", made))
    read = read_motion(tmp_path / "a.json", eyes="optical")
    np.testing.assert_allclose(read.motion.lid, made.lid, atol=1e-6)
    yaw, pitch = rotation.gaze_to_angles(read.motion.gaze).mean(axis=1).T
    wanted = rotation.cyclopean_gaze(rotation.gaze_to_angles(made.gaze))
    np.testing.assert_allclose(np.stack([yaw, pitch], axis=1), wanted, atol=1e-3)
    assert read.notes[0].startswith("36 of 46 shapes have no place here: browLowerL, browLowerR, innerBrowRaiserL, ")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            {"dt": [100, 900], "vs": {"jawOpen": [0, 1]}},
            "TalkingHead's dt should be even, a key a frame, got 100 to 900",
        ),
        ([{"faceBlendshapes": [categories(TABLE[0])]}] * 3, "should contain its frame rate, got none; set --fps"),
        ({"FrameIndex": 0, "BlendShapes": [[0.1, 0.2]] * 3}, "rows should be numbers, one for each name"),
        ([{"FrameIndex": k * 10**9, "BlendShapes": [[0.0] * 55]} for k in range(2)], "FrameIndex should be at most"),
        ({"version": 1, "lipsync": [{"start": 0, "value": "X"}]}, "or frames of them, got version, lipsync"),
        (
            {"names": ["a", "b"], "fps": 30, "rows": [[0, 1]] * 9},
            "should have shapes of a face (EyeLookInLeft, ...), got",
        ),
        ([], "or frames of them, got a list"),
        ("text", "or frames of them, got a str"),
    ],
)
def test_other_layouts_are_one_line_errors(tmp_path: Path, content: Any, message: str) -> None:
    (tmp_path / "a.json").write_text(json.dumps(content))
    with pytest.raises(InputError) as error:
        read_motion(tmp_path / "a.json")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_json_keeps_its_encoding(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"voice": "Jörg", **azure()}, ensure_ascii=False), encoding)
    new = edited(tmp_path / "a.json")
    assert new[:2] == (tmp_path / "a.json").read_bytes()[:2]
    assert json.loads(new.decode(encoding))["voice"] == "Jörg"
