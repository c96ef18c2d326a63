"""Lids on head models: the open head and one with FLAME's layout have the same lids for gaze and closure."""

from pathlib import Path

import flame_file
import numpy as np
import pytest

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyelid.anatomy import (
    IRIS_CENTRE_M,
    SCLERA_RADIUS_M,
    EyelidParameters,
    eyeball_radius_m,
    lid_points,
    sample_eyelid_parameters,
)
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES, eyelid_weights
from talkingeyes.head.eyelid.model import LOWER, POINTS, UPPER, explained_variance, fit_eyelid_model, lid_opening_m
from talkingeyes.head.eyelid.postures import anatomical_lid_curves, held_out_postures, paper_postures, posture_grid
from talkingeyes.head.eyelid.region import eyelid_region
from talkingeyes.head.flame import load_flame
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import Pose, expression_shape_names, motion_to_pose


@pytest.fixture(scope="module", params=["anny", "flame"])
def head(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> HeadModel:
    if request.param == "anny":
        return anny_head()
    path: Path = tmp_path_factory.mktemp("flame") / "model.pkl"
    flame_file.write(path, flame_file.arrays())
    return load_flame(path)


def points_at(head: HeadModel, yaw_deg: float, pitch_deg: float, lid: tuple[float, float]) -> dict[str, np.ndarray]:
    """Lid landmarks for a posture of both eyes, in metres, without head rotation."""
    gaze = np.repeat(angles_to_gaze(np.radians([[yaw_deg, pitch_deg]]))[:, None], 2, axis=1)
    motion = Motion.of(25.0, np.zeros((1, 3)), gaze, lid=np.array([lid]))
    pose: Pose = motion_to_pose(head, motion)
    rest = head.template + np.tensordot(pose.expression[0], head.expression, axes=1)
    return dict(zip(head.landmarks.names, head.landmarks.of(rest), strict=True))


def opening_m(points: dict[str, np.ndarray], side: str) -> float:
    heights = [points[f"{side}_eye_{lid}_{at}"][1] for lid in ("upper", "lower") for at in ("outer", "inner")]
    return float(heights[0] + heights[1] - heights[2] - heights[3]) / 2


def test_at_rest_no_shape_has_weight_and_motion_carries_none(head: HeadModel):
    weights = eyelid_weights(head, np.zeros((1, 2, 3)), np.zeros((1, 2)))
    assert set(weights) == set(LID_SHAPES)
    assert all(column == 0 for column in weights.values())
    assert not set(LID_SHAPES) & set(expression_shape_names(head))


@pytest.mark.parametrize("gaze_deg", [(0, 0), (20, 5), (-20, -15), (0, 15), (0, -25)])
def test_closure_is_closed_fraction_of_the_opening(head: HeadModel, gaze_deg: tuple[float, float]):
    alone = points_at(head, *gaze_deg, (0.0, 0.0))
    for lid in (0.5, 1.0, -0.2):
        closed = points_at(head, *gaze_deg, (lid, lid))
        for side in ("left", "right"):
            left_open = opening_m(alone, side)
            assert left_open > 0.002
            assert opening_m(closed, side) == pytest.approx((1 - lid) * left_open, abs=1e-6)


def test_lids_follow_gaze_up_and_down_the_lower_less(head: HeadModel):
    """At 20 degrees the surface of the eye moves by 4.4 mm; the upper lid nearly as much, the lower about a third."""
    ahead, down, up = (points_at(head, 0, pitch, (0.0, 0.0)) for pitch in (0, -20, 12))
    for side in ("left", "right"):
        upper, lower = f"{side}_eye_upper_inner", f"{side}_eye_lower_inner"
        fallen, lowered = ahead[upper][1] - down[upper][1], ahead[lower][1] - down[lower][1]
        assert 0.0025 < fallen < 0.0055
        assert 0.1 * fallen < lowered < 0.75 * fallen
        assert up[upper][1] > ahead[upper][1] + 0.0008
        assert opening_m(down, side) < opening_m(ahead, side) < opening_m(up, side)


def test_an_eye_winks_alone_and_left_is_left(head: HeadModel):
    both, left = points_at(head, 0, 0, (0.0, 0.0)), points_at(head, 0, 0, (1.0, 0.0))
    assert opening_m(left, "left") == pytest.approx(0, abs=1e-6)
    assert opening_m(left, "right") == pytest.approx(opening_m(both, "right"), abs=1e-5)
    assert both["left_eye_outer"][0] > both["left_eye_inner"][0] > 0 > both["right_eye_inner"][0]


def test_corners_nearly_stay(head: HeadModel):
    ahead, down = points_at(head, 0, 0, (0.0, 0.0)), points_at(head, 0, -20, (0.5, 0.5))
    for side in ("left", "right"):
        for corner in ("outer", "inner"):
            assert np.linalg.norm(down[f"{side}_eye_{corner}"] - ahead[f"{side}_eye_{corner}"]) < 0.0025


def test_the_outer_corner_follows_abduction_but_not_adduction(head: HeadModel):
    """2 mm at 45 degrees of abduction (Gioia, Linberg & McCormick 1987)."""
    ahead, to_left, to_right = (points_at(head, yaw, 0, (0.0, 0.0)) for yaw in (0, 25, -25))
    for side, abducted, adducted, outwards in (("left", to_left, to_right, 1), ("right", to_right, to_left, -1)):
        outer, inner = f"{side}_eye_outer", f"{side}_eye_inner"
        moved = [outwards * (each[outer] - ahead[outer])[0] for each in (abducted, adducted)]
        assert 0.0006 < moved[0] < 0.0016
        assert abs(moved[1]) < 0.0004
        for each in (abducted, adducted):
            assert abs((each[inner] - ahead[inner])[0]) < 0.0005


def test_shapes_have_the_full_form_of_the_curves_not_heights_alone(head: HeadModel):
    """For horizontal gaze: where the cornea lifts the lids, and where the corner goes."""
    around = eyelid_region(head, 0)
    model = fit_eyelid_model(posture_grid(around, EyelidParameters()))
    angles = np.radians([[25.0, 0.0], [-25.0, 0.0]])
    wanted = (model.gaze_only_curves(angles) - model.gaze_only_curves(np.zeros(2)))[:, : LOWER.stop]
    motion = Motion.of(25.0, np.zeros((2, 3)), np.repeat(angles_to_gaze(angles)[:, None], 2, axis=1))
    moved = np.tensordot(motion_to_pose(head, motion).expression, head.expression, axes=1)
    left = around.curves.of(moved)[:, : LOWER.stop] - wanted
    assert np.linalg.norm(left) < 0.5 * np.linalg.norm(wanted)


def test_the_curves_of_a_region_run_from_corner_to_corner(head: HeadModel):
    for eye in range(2):
        around = eyelid_region(head, eye)
        for lid in (UPPER, LOWER):
            curve = around.points[lid]
            assert np.all(np.diff(curve[:, 0]) > -0.001)  # outwards
            np.testing.assert_allclose(curve[[0, -1]], around.points[UPPER][[0, -1]], atol=1e-12)
        assert 0.004 < lid_opening_m(around.points) < 0.013
        assert len(around.points) == POINTS + len(around.vertices)


def test_real_lids_lie_on_the_eyeball_and_the_cornea_lifts_them():
    around = eyelid_region(anny_head(), 0)
    still = lid_points(around, np.zeros((1, 2)), np.zeros(1), EyelidParameters(), np.zeros(1))[0]
    shut = lid_points(around, np.zeros((1, 2)), np.ones(1), EyelidParameters(), np.zeros(1))[0]
    up, aside = lid_points(around, np.array([[0.0, 0.2], [0.5, 0.2]]), np.zeros(2), EyelidParameters(), np.zeros(2))
    np.testing.assert_allclose(still, around.points, atol=1e-9)
    assert abs(lid_opening_m(shut)) < 1e-3
    over, beside = (np.linalg.norm(points, axis=1) for points in (up, aside))
    assert (over - beside).max() > 1e-4
    ahead = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    apex, pole = eyeball_radius_m(ahead, ahead[:1])
    assert pole == SCLERA_RADIUS_M
    assert apex > IRIS_CENTRE_M + 0.0025


@pytest.mark.parametrize("eye", [0, 1])
def test_most_but_not_all_of_real_lids_is_explained_on_held_out_gazes(eye: int):
    rng = np.random.default_rng(eye)
    lids_of = anatomical_lid_curves(eyelid_region(anny_head(), eye), sample_eyelid_parameters(rng))
    labels = paper_postures(lids_of, rng)
    held_out = held_out_postures(lids_of, labels.angles_rad, 150, rng)
    nearest = np.linalg.norm(held_out.angles_rad[:, None] - labels.angles_rad, axis=-1).min()
    assert len(labels.curves) == 34
    assert nearest > np.radians(0.8)  # both are measured on rendered irises
    shares = explained_variance(fit_eyelid_model(labels), held_out)
    assert shares.stage_one < shares.both_stages - 0.3
    assert 0.85 < shares.both_stages < 0.95
