"""Analysis by synthesis: energies; gaze and lid closure estimated from pictures of the open head with known truth."""

import numpy as np
import pytest

from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import angle_between_deg
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_direction, angles_to_gaze
from talkingeyes.fitting.analysis_by_synthesis import (
    EyeEstimate,
    EyeGeometry,
    PosedImage,
    blink_energy,
    estimate_eye,
    gaze_energy,
    red_bias,
)
from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyelid.model import LabelledPostures, fit_eyelid_model
from talkingeyes.head.eyelid.region import TEMPORAL_AXES, eyelid_region
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import Framing, OrbitCamera

VIEWS = [Framing(0.285, (0.0, 0.03, 0.0), yaw_deg=yaw).view(256, 256) for yaw in (0.0, 30.0)]
HEAD_RAD, MOVED_M = np.array([0.05, -0.12, 0.04]), np.array([0.004, -0.003, 0.006])


def motion(angles_rad: np.ndarray, lid: np.ndarray, head: np.ndarray, translation: np.ndarray) -> Motion:
    count = len(lid)
    gaze = angles_to_gaze(np.repeat(angles_rad[:, None], 2, axis=1))
    poses = {"translation": np.tile(translation, (count, 1)), "lid": np.repeat(lid[:, None], 2, axis=1)}
    return Motion.of(25.0, np.tile(head, (count, 1)), gaze, **poses)


@pytest.fixture(scope="module")
def eyes() -> list[EyeGeometry]:
    """The Eyelid models of the lids of the open head."""
    head = anny_head()
    yaw, pitch, lid = np.meshgrid([-0.4, 0.0, 0.4], [-0.4, -0.2, 0.0, 0.25], [0.0, 0.5, 1.0])
    angles, closures = np.stack([yaw.ravel(), pitch.ravel()], axis=-1), lid.ravel()
    vertices = posed_vertices(head, motion_to_pose(head, motion(angles, closures, np.zeros(3), np.zeros(3)))).astype(
        np.float64
    )
    found = []
    for eye in range(2):
        around = eyelid_region(head, eye)
        curves = (around.curves.of(vertices) - around.centre) * TEMPORAL_AXES[eye]
        found.append(
            EyeGeometry(
                eye, around.centre, fit_eyelid_model(LabelledPostures(angles, curves, closures == 0, closures == 1))
            )
        )
    return found


def posed_images(angles_deg: tuple[float, float], lid: float, views: list[OrbitCamera]) -> list[PosedImage]:
    """Pictures of a rotated and translated head with known pose."""
    shown = motion(np.radians([angles_deg]), np.array([lid]), HEAD_RAD, MOVED_M)
    images = [next(iter(HeadRenderer(anny_head(), view).draw(shown))) / 255.0 for view in views]
    return [PosedImage(image, view, HEAD_RAD, MOVED_M) for image, view in zip(images, views, strict=True)]


def error_deg(found: EyeEstimate, angles_deg: tuple[float, float]) -> float:
    return float(angle_between_deg(angles_to_direction(found.angles_rad), angles_to_direction(np.radians(angles_deg))))


@pytest.mark.parametrize("angles_deg", [(0.0, 0.0), (14.0, 5.0), (-12.0, -9.0)])
def test_gaze_of_open_eyes_is_found(eyes: list[EyeGeometry], angles_deg: tuple[float, float]):
    seen = posed_images(angles_deg, 0.05, VIEWS)
    for eye in eyes:
        found = estimate_eye(seen, eye)
        assert not found.nearly_shut
        assert error_deg(found, angles_deg) < 2.0
        assert abs(found.lid - 0.05) < 0.25


def test_half_closed_eyes_from_one_view(eyes: list[EyeGeometry]):
    found = estimate_eye(posed_images((6.0, -3.0), 0.45, VIEWS[:1]), eyes[1])
    assert not found.nearly_shut
    assert abs(found.lid - 0.45) < 0.15
    assert error_deg(found, (6.0, -3.0)) < 4.0


@pytest.mark.parametrize("lid", [0.85, 1.0])
def test_nearly_closed_eyes_are_flagged_and_not_guessed(eyes: list[EyeGeometry], lid: float):
    for eye in eyes:
        found = estimate_eye(posed_images((5.0, 0.0), lid, VIEWS[:1]), eye)
        assert found.nearly_shut
        assert np.isnan(found.angles_rad).all()


def test_red_bias_is_fraction_of_red():
    assert red_bias(np.array([0.9, 0.0, 0.0])) > 0.9
    np.testing.assert_allclose(red_bias(np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])), 1 / 3)


def test_blink_energy_is_minimal_at_the_opening():
    bias = np.where(np.abs(np.arange(40) - 20) < 6, 0.33, 0.45)  # a row of pixels through an eye surrounded by skin
    energy = [blink_energy(bias, (np.abs(np.arange(40) - 20) < half).astype(float)) for half in range(1, 15)]
    assert 1 + int(np.argmin(energy)) == 6
    assert (
        blink_energy(-bias, (np.abs(np.arange(40) - 20) < 6).astype(float)) > 0
    )  # an opening that is redder than skin
    assert blink_energy(bias, np.zeros(40)) == blink_energy(bias, np.ones(40)) == 0


def test_gaze_energy_is_minimal_at_the_iris_and_ignores_lighter_regions():
    place = np.arange(40)
    red = np.where(np.abs(place - 25) < 5, 0.2, 0.8)
    inside = ((place > 5) & (place < 35)).astype(float)
    energy = [gaze_energy(red, inside, (np.abs(place - at) < 5).astype(float)) for at in range(10, 31)]
    assert 10 + int(np.argmin(energy)) == 25
    iris = (np.abs(place - 25) < 5).astype(float)
    assert gaze_energy(1 - red, inside, iris) > gaze_energy(red, inside, iris) + 0.01


def test_invisible_eye_is_an_error(eyes: list[EyeGeometry]):
    with pytest.raises(InputError, match="at least one image"):
        estimate_eye([], eyes[0])
    seen = posed_images((0.0, 0.0), 0.0, VIEWS[:1])[0]
    beside = PosedImage(seen.image, seen.view, seen.head, np.array([5.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="inside at least one image"):
        estimate_eye([beside], eyes[0])
