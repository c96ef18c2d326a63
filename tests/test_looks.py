"""Looks of the open head: eyes stay in place, lids close, hair, teeth and lashes show, options and exports."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from command_line import call

from talkingeyes.core.motion import Motion
from talkingeyes.head.anny import anny_head
from talkingeyes.head.landmarks import pupil_centres
from talkingeyes.head.looks import LOOKS, dressed_head
from talkingeyes.head.model import PARTS, HeadModel
from talkingeyes.head.normals import vertex_normals
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.rendering.contact_sheet import static_motion
from talkingeyes.rendering.render import HeadRenderer, RayCaster
from talkingeyes.rendering.view import FRAMINGS, Framing

ABOVE = Framing(0.285, (0.0, 0.03, 0.0), pitch_deg=60.0, yaw_deg=150.0)


def still(jaw_deg: float = 0.0, lid: float = 0.0) -> Motion:
    closed = np.full((1, 2), lid)
    return Motion.of(25.0, np.zeros((1, 3)), np.zeros((1, 2, 3)), lid=closed, jaw=np.radians([[jaw_deg, 0.0, 0.0]]))


def seen(head: HeadModel, motion: Motion, framing: Framing = FRAMINGS["face"]) -> Counter[str]:
    """Pixels of each part in a picture of 128 x 128."""
    renderer = HeadRenderer(head, framing.view(128, 128))
    (vertices,) = posed_vertices(head, motion_to_pose(head, motion))
    normals = vertex_normals(vertices[None], head.faces)[0].astype(np.float32)
    caster = RayCaster.of(renderer, vertices, normals, renderer.view.project(vertices))
    parts = caster.trace(renderer._rays.reshape(-1, 3)).parts
    return Counter(PARTS[part] for part in parts if part >= 0)


@pytest.mark.parametrize("name", LOOKS)
def test_a_look_keeps_the_eyes_and_shows_what_a_face_has(name: str) -> None:
    plain, head = anny_head(), dressed_head(name)
    eyes = plain.vertices_of("sclera", "iris", "pupil")
    np.testing.assert_array_equal(head.template[eyes], plain.template[eyes])
    np.testing.assert_array_equal(head.eye_centres, plain.eye_centres)
    (vertices,) = posed_vertices(head, motion_to_pose(head, static_motion(gaze_deg=np.array([[14.0, -9.0]]))))
    gaze = static_motion(gaze_deg=np.array([[14.0, -9.0]])).gaze
    np.testing.assert_allclose(vertices[head.pupils], pupil_centres(gaze)[0], atol=1e-5)

    closed, half, open_ = (seen(head, still(jaw)) for jaw in (0, 6, 14))
    assert closed["teeth"] <= 2  # dark gums in the corners of the mouth
    assert closed["tongue"] == 0
    assert half["teeth"] > 10
    assert open_["teeth"] > 20
    assert open_["tongue"] > 20
    assert min(closed["iris"], closed["pupil"]) > 8
    shut = seen(head, still(lid=1.0), FRAMINGS["eyes"])
    assert shut["iris"] == shut["sclera"] == shut["pupil"] == 0
    above = seen(head, still(), ABOVE)
    assert above["hair"] > 5 * above["skin"]
    below = seen(head, still(), Framing(0.5, (0.0, -0.06, 0.0)))
    assert below["cloth"] > 1000


def test_lashes_point_up_from_open_lids_and_down_from_shut_ones() -> None:
    head = dressed_head()
    lash = head.vertices_of("lash")
    (rest,), (shut,) = (posed_vertices(head, motion_to_pose(head, still(lid=lid)))[:, lash] for lid in (0.0, 1.0))
    upper = rest[:, 1] > head.eye_centres[0, 1]
    forward = np.argsort(rest[upper, 2])
    tips, roots = forward[-60:], forward[:60]
    rises = [points[upper][tips, 1].mean() - points[upper][roots, 1].mean() for points in (rest, shut)]
    assert rises[0] > 0.0005
    assert rises[1] < rises[0] - 0.0015


def test_faces_of_looks_differ_and_landmarks_of_the_open_head_do_not_know_them() -> None:
    plain = anny_head()
    skin = plain.vertices_of("lips")
    shapes = [dressed_head(name).template[skin] for name in LOOKS]
    for one in range(3):
        assert np.abs(shapes[one] - shapes[one - 1]).max() > 0.001
    assert anny_head() is plain
    assert plain.landmarks.corners.max() < plain.vertices_of("brow").min()


def test_looks_are_chosen_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motion = tmp_path / "motion.npz"
    still().save(motion)
    sizes = {}
    for name in (None, *LOOKS):
        out = tmp_path / f"{name}.glb"
        assert call("export", str(motion), "-o", str(out), *([] if name is None else ["--look", name])) == 0
        content = out.read_bytes()
        document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
        place = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
        sizes[name] = document["accessors"][place]["count"]
    assert sizes == {None: sizes["ada"], **{name: len(dressed_head(name).template) for name in LOOKS}}
    capsys.readouterr()
    for words, says in (
        (["render", str(motion), "-o", str(tmp_path / "a.mp4"), "--look", "eve"], "ada, ben, chi, got 'eve'"),
        (["head", "-o", str(tmp_path / "a.png"), "--look", "eve"], "ada, ben, chi, got 'eve'"),
        (["export", str(motion), "-o", str(tmp_path / "a.usda"), "--look", "ben"], "glb and mp4 only, got usd"),
        (["render", str(motion), "-o", str(tmp_path / "a.mp4"), "--head", "flame", "--look", "ben"], "got flame"),
    ):
        assert call(*words) == 2
        assert says in capsys.readouterr().err
    assert not [path for path in tmp_path.iterdir() if path.name.startswith("a.")]
