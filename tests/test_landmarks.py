"""Landmarks of the open head: lids follow gaze and close, the jaw moves the chin, pupils rotate with the eyes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from talkingeyes.core.motion import Motion
from talkingeyes.fitting.blink import aspect_ratio, eye_aspect_ratio
from talkingeyes.head.anny import anny_head
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS, LANDMARK_NAMES
from talkingeyes.head.landmarks import (
    EYE_CENTRES,
    PUPIL_OFFSET_M,
    RIGID_LANDMARKS,
    eye_landmarks,
    head_to_scene,
    landmarks,
    pupil_centres,
)
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices

ANGLES = st.floats(-0.5, 0.5)
OPENINGS = st.floats(0.0, 1.0)


def looking(pitch_deg: float, lid: float = 0.0, jaw_rad: float = 0.0) -> np.ndarray:
    """Landmarks of one frame."""
    gaze = np.zeros((1, 2, 3))
    gaze[..., 0] = -np.radians(pitch_deg)
    return landmarks(gaze, np.full((1, 2), lid), np.array([[jaw_rad, 0.0, 0.0]]))


def place(points: np.ndarray, name: str) -> np.ndarray:
    """One landmark of the first frame."""
    return points[0, LANDMARK_NAMES.index(name)]


def test_every_point_has_one_name():
    assert len(set(LANDMARK_NAMES)) == len(LANDMARK_NAMES) == looking(0).shape[1]
    assert len(RIGID_LANDMARKS) == 12


def test_points_and_pupils_are_those_of_the_posed_head():
    rng = np.random.default_rng(0)
    motion = Motion.of(
        25.0,
        rng.normal(0, 0.2, (5, 3)),
        rng.normal(0, 0.2, (5, 2, 3)),
        lid=rng.uniform(0, 1, (5, 2)),
        jaw=np.abs(rng.normal(0, 0.1, (5, 3))),
        translation=rng.normal(0, 0.01, (5, 3)),
    )
    head = anny_head()
    np.testing.assert_allclose(head.eye_centres, EYE_CENTRES, atol=1e-6)
    vertices = posed_vertices(head, motion_to_pose(head, motion))
    points = head_to_scene(landmarks(motion.gaze, motion.lid, motion.jaw), motion.head, motion.translation)
    on_skull = [
        place for place, name in enumerate(LANDMARK_NAMES) if "outline" not in name
    ]  # the skin of the neck follows in part
    np.testing.assert_allclose(head.landmarks.of(vertices)[:, on_skull], points[:, on_skull], atol=2e-5)
    np.testing.assert_allclose(
        vertices[:, head.pupils], head_to_scene(pupil_centres(motion.gaze), motion.head, motion.translation), atol=2e-5
    )


def test_neutral_opening_is_that_of_a_face():
    points = looking(0)
    assert aspect_ratio(points[:, EYE_LANDMARKS]) == pytest.approx(0.33, abs=0.01)
    upper, lower = place(points, "left_eye_upper_outer"), place(points, "left_eye_lower_outer")
    assert upper[1] - lower[1] == pytest.approx(0.0091, abs=2e-4)


def test_looking_down_20_degrees_lowers_the_upper_lid():
    ahead, down = looking(0), looking(-20)
    lowered = place(ahead, "left_eye_upper_inner") - place(down, "left_eye_upper_inner")
    assert 0.002 < lowered[1] < 0.005
    fall = 1 - aspect_ratio(down[:, EYE_LANDMARKS]) / aspect_ratio(ahead[:, EYE_LANDMARKS])
    assert np.all((fall > 0.1) & (fall < 0.36))


@given(ANGLES, OPENINGS)
@settings(max_examples=30)
def test_the_opening_left_is_one_minus_the_closure(pitch_rad: float, lid: float):
    gaze = np.zeros((1, 2, 3))
    gaze[..., 0] = -pitch_rad
    heights = [opening(eye_landmarks(gaze, np.full((1, 2), closure))) for closure in (0.0, lid)]
    np.testing.assert_allclose(heights[1], (1 - lid) * heights[0], atol=1e-8)


def opening(points: np.ndarray) -> np.ndarray:
    """Mean height of upper above lower lid landmarks."""
    return (points[:, :, 1:3, 1] - points[:, :, 4:6, 1]).mean(axis=-1)


def test_shut_lids_meet():
    ratio = aspect_ratio(eye_landmarks(np.zeros((1, 2, 3)), np.ones((1, 2))))
    assert np.all(ratio < 0.08)  # people: under 0.15; the lids meet in height, not quite in depth


def test_the_jaw_lowers_chin_and_lower_lip_and_hardly_a_rigid_point():
    shut, open_ = looking(0), looking(0, jaw_rad=0.2)
    assert place(open_, "outline_chin")[1] < place(shut, "outline_chin")[1] - 0.008
    assert place(open_, "lower_lip")[1] < place(shut, "lower_lip")[1] - 0.008
    assert place(open_, "upper_lip_inner")[1] > place(shut, "upper_lip_inner")[1] - 0.001
    assert np.abs(open_[:, RIGID_LANDMARKS] - shut[:, RIGID_LANDMARKS]).max() < 0.0007


def test_left_is_the_subjects_left_and_on_the_right_of_the_picture():
    camera = Camera(1000.0, (112.0, 112.0), 1.0, 224, 224)
    points = looking(0)
    left, right = place(points, "left_eye_outer"), place(points, "right_eye_outer")
    assert left[0] > 0 > right[0]
    assert camera.project(left)[0] > camera.project(right)[0]
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=2e-4)


@given(ANGLES, ANGLES)
def test_pupils_stay_on_their_sphere(x_rad: float, y_rad: float):
    gaze = np.tile([x_rad, y_rad, 0.0], (1, 2, 1))
    reach = np.linalg.norm(pupil_centres(gaze) - EYE_CENTRES, axis=-1)
    np.testing.assert_allclose(reach, PUPIL_OFFSET_M, atol=1e-12)


def test_pupil_projection_turns_by_its_lever():
    """Distance from the eye centre times the sine of the angle, at the pixels per metre of the pupil's depth."""
    camera = Camera(1154 * 0.925, (112.0, 112.0), 1.0, 224, 224)
    gaze = np.zeros((2, 2, 3))
    gaze[1, :, 1] = np.radians(1.0)
    moved = np.diff(camera.project(pupil_centres(gaze))[..., 0], axis=0)
    scale = camera.focal_px / (1.0 - EYE_CENTRES[0, 2] - PUPIL_OFFSET_M)
    assert moved == pytest.approx(scale * PUPIL_OFFSET_M * np.sin(np.radians(1.0)), rel=0.01)


def test_head_turns_about_its_origin_and_then_moves():
    points = looking(0)
    head, move = np.array([[0.0, np.pi / 2, 0.0]]), np.array([[0.01, 0.02, 0.03]])
    turned = head_to_scene(points, head, move)
    nose = LANDMARK_NAMES.index("nose_tip")
    np.testing.assert_allclose(turned[0, nose] - move[0], [points[0, nose, 2], points[0, nose, 1], 0.0], atol=1e-12)


def test_hidden_landmarks_give_no_aspect_ratio():
    seen = looking(0)[..., :2].copy()
    seen[0, EYE_LANDMARKS[1, 2]] = np.nan
    ratio = eye_aspect_ratio(seen)
    assert np.isfinite(ratio[0, 0])
    assert np.isnan(ratio[0, 1])
