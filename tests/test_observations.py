"""Simulated observations: exact without disturbances; each disturbance and its parameter."""

from dataclasses import replace

import numpy as np
import pytest
from model_conf import compose
from pydantic import ValidationError

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.anny import anny_head
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES
from talkingeyes.head.landmarks import EYE_CENTRES, rest_landmarks
from talkingeyes.head.observation import Observation
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.physiology.face import FACE_SHAPES
from talkingeyes.synthesis import corruptions, detector_noise
from talkingeyes.synthesis.detector_noise import NoiseSettings
from talkingeyes.synthesis.observations import (
    CameraSettings,
    exact_landmarks_px,
    exact_pupils_px,
    identity_weights,
    make_camera,
    observe,
)

SECTION = compose(["synthesize=default"])["synthesize"]
CAMERA, NOISE = CameraSettings(**SECTION["camera"]), NoiseSettings(**SECTION["noise"])
FPS = 25.0
SOMEBODY = (0.3, -0.2, 0.1, 0.0, 0.2, -0.3)


def camera(**changes) -> Camera:
    return make_camera(CAMERA.model_copy(update=changes), np.random.default_rng(0))


def quiet(**changes) -> NoiseSettings:
    """Settings of detectors without errors, with `changes` applied by part."""
    silent = {name: 0.0 for name in ("bias_px", "ar_px", "white_min_px", "white_max_px", "burst_share")}
    unit = {f"gain_{axis}_{end}": 1.0 for axis in "xy" for end in ("min", "max")}
    pupil = NOISE.pupil.model_copy(update={**silent, **unit})
    landmark = NOISE.landmark.model_copy(update={"bias_px": 0.0, "ar_px": 0.0, "white_px": 0.0})
    return NOISE.model_copy(update={"pupil": pupil, "landmark": landmark, **changes})


def motion_ahead(frames, yaw_rad=0.0):
    """Gaze up and aside with open eyes and turned head."""
    gaze = np.broadcast_to(rotation.angles_to_gaze(np.array([0.3, 0.2])), (frames, 2, 3)).copy()
    return Motion.of(FPS, np.tile([0.0, yaw_rad, 0.0], (frames, 1)), gaze)


def seen(settings, motion=None, seed=0, identity=()):
    motion = motion or motion_ahead(100)
    return observe(motion, camera(), settings, np.random.default_rng(seed), identity)


def test_pupils_are_those_of_the_head():
    """Pupils at zero and other rotations equal those of the posed head, to 0.0001 pixels."""
    still, turned = Motion.of(FPS, np.zeros((1, 3)), np.zeros((1, 2, 3))), motion_ahead(1, 0.3)
    head = anny_head()
    for motion in (still, turned):
        corners = posed_vertices(head, motion_to_pose(head, motion))[0, head.pupils].astype(np.float64)
        assert np.abs(camera().project(corners) - exact_pupils_px(motion, camera())[0]).max() < 1e-4


def test_landmarks_are_those_of_the_head_with_its_expression():
    rng = np.random.default_rng(0)
    expression = rng.uniform(0, 0.4, (2, len(FACE_SHAPES)))
    motion = Motion.of(
        FPS,
        np.zeros((2, 3)),
        np.zeros((2, 2, 3)),
        jaw=np.array([[0.1, 0, 0], [0, 0, 0]]),
        expression=expression,
        expression_names=FACE_SHAPES,
    )
    head = anny_head()
    points = head.landmarks.of(posed_vertices(head, motion_to_pose(head, motion)).astype(np.float64))
    assert np.abs(camera().project(points) - exact_landmarks_px(motion, camera())).max() < 0.01


def test_distance_changes_perspective_alone():
    motion = Motion.of(FPS, np.zeros((1, 3)), np.zeros((1, 2, 3)))
    near, far = (camera(distance_min_m=distance, distance_max_m=distance) for distance in (0.4, 4.0))
    pupils = [exact_pupils_px(motion, each)[0] for each in (near, far)]
    widths = [pupil[0, 0] - pupil[1, 0] for pupil in pupils]
    assert widths == pytest.approx([63 * 1.154] * 2, rel=0.05)
    ears = [exact_landmarks_px(motion, each)[0, LANDMARK_NAMES.index("left_outline_ear"), 0] for each in (near, far)]
    assert ears[1] > ears[0] + 5
    drawn = [make_camera(CAMERA, np.random.default_rng(seed)).distance_m for seed in range(50)]
    assert CAMERA.distance_min_m <= min(drawn) < max(drawn) <= CAMERA.distance_max_m


def test_heads_differ_and_eyes_stay():
    mean, other = rest_landmarks(), rest_landmarks(SOMEBODY)
    moved_m = np.linalg.norm(other - mean, axis=-1)
    assert 0.001 < moved_m.mean() < 0.02
    motion = motion_ahead(1)
    assert not np.allclose(
        exact_landmarks_px(motion, camera(), SOMEBODY), exact_landmarks_px(motion, camera()), atol=0.5
    )
    head = anny_head()
    centres = head.eye_centres + np.tensordot(SOMEBODY, head.identity_joints[:, 3:], axes=1)
    scale = 0.063 / (centres[0, 0] - centres[1, 0])
    nose = head.landmarks.of(head.template + np.tensordot(SOMEBODY, head.identity, axes=1))[
        LANDMARK_NAMES.index("nose_tip")
    ]
    from_eyes = other[LANDMARK_NAMES.index("nose_tip")] - EYE_CENTRES.mean(axis=0)
    assert from_eyes == pytest.approx(scale * (nose - centres.mean(axis=0)), abs=2e-4)
    assert seen(quiet(), identity=SOMEBODY).identity == SOMEBODY
    with pytest.raises(InputError, match="should be 6 weights, got 2"):
        rest_landmarks((0.1, 0.2))


def test_spread_of_heads_is_as_configured():
    numbers = np.random.default_rng(0).standard_normal((500, 6))
    shapes = np.array([identity_weights(tuple(each), CAMERA) for each in numbers])
    assert shapes.std() == pytest.approx(CAMERA.identity_std, rel=0.1)
    assert np.abs(shapes).max() <= 2 * CAMERA.identity_std + 1e-12
    assert not any(identity_weights((1.0, -1.0), CAMERA.model_copy(update={"identity_std": 0.0})))


def test_observation_without_errors_is_exact():
    motion = motion_ahead(50)
    observed = seen(quiet(), motion)
    assert np.array_equal(observed.pupils, exact_pupils_px(motion, camera()))
    assert np.array_equal(observed.landmarks, exact_landmarks_px(motion, camera()))
    assert (observed.confidence == 1.0).all()


@pytest.mark.parametrize("name", ["bias_px", "ar_px", "white_px"])
def test_landmark_noise(name):
    settings = quiet()
    settings = settings.model_copy(update={"landmark": settings.landmark.model_copy(update={name: 0.4})})
    motion = motion_ahead(300)
    error = seen(settings, motion).landmarks - exact_landmarks_px(motion, camera())
    assert error.std() == pytest.approx(0.4, rel=0.15)
    step = np.diff(error, axis=0).std()
    assert {"bias_px": step < 1e-9, "ar_px": 0.05 < step < 0.2, "white_px": 0.5 < step < 0.65}[name]


@pytest.mark.parametrize("name", ["bias_px", "ar_px", "white_min_px"])
def test_pupil_noise(name):
    settings = quiet()
    changed = {name: 0.4} | ({"white_max_px": 0.4} if name == "white_min_px" else {})
    settings = settings.model_copy(update={"pupil": settings.pupil.model_copy(update=changed)})
    motion = motion_ahead(200)
    exact = exact_pupils_px(motion, camera())
    errors = np.stack([seen(settings, motion, seed).pupils - exact for seed in range(25)])
    assert errors.std() == pytest.approx(0.4, rel=0.25)
    step = np.diff(errors, axis=1).std()
    assert {"bias_px": step < 1e-9, "ar_px": step < 0.2, "white_min_px": step > 0.5}[name]


def test_a_pupil_follows_less_than_it_should():
    settings = quiet()
    gain = {f"gain_{axis}_{end}": value for axis, value in (("x", 0.9), ("y", 0.8)) for end in ("min", "max")}
    settings = settings.model_copy(update={"pupil": settings.pupil.model_copy(update=gain)})
    motion = motion_ahead(3)
    ahead = exact_pupils_px(replace(motion, gaze=0 * motion.gaze), camera())
    exact = exact_pupils_px(motion, camera())
    assert (seen(settings, motion).pupils - ahead) / (exact - ahead) == pytest.approx(
        np.broadcast_to([0.9, 0.8], exact.shape), abs=1e-6
    )


def test_lids_hide_pupils():
    motion = replace(motion_ahead(40), lid=np.where(np.arange(40)[:, None] < 20, 0.8, 0.0) * np.ones((1, 2)))
    observed = seen(quiet(), motion)
    assert np.isnan(observed.pupils[:20]).all() and np.isfinite(observed.pupils[20:]).all()
    assert observed.confidence[:20].max() < 0.6 < observed.confidence[20:].min()


def test_hands_and_hair_cover_a_part_for_a_while():
    settings = quiet(occlusion=NOISE.occlusion.model_copy(update={"rate_per_min": 20.0}))
    long = motion_ahead(1500)
    observed = seen(settings, long)
    hidden = np.isnan(observed.landmarks).any(axis=-1)
    assert 0.05 < hidden.any(axis=1).mean() < 0.6
    assert 0.02 < hidden[hidden.any(axis=1)].mean() < 0.6
    starts = np.flatnonzero(np.diff(hidden.any(axis=1).astype(int)) == 1)
    assert 5 < len(starts) < 30 and 0.2 < hidden.any(axis=1).sum() / FPS / len(starts) < 3.0
    assert (observed.confidence[hidden.any(axis=1)] < 1).all() and (observed.confidence[~hidden.any(axis=1)] == 1).all()
    assert np.array_equal(observed.landmarks[~hidden], exact_landmarks_px(long, camera())[~hidden])


def test_only_hair_is_at_the_sides():
    chin, temple = LANDMARK_NAMES.index("outline_chin"), LANDMARK_NAMES.index("left_outline_temple")
    for share, covered, free in ((1.0, chin, None), (0.0, temple, chin)):
        changed = {"rate_per_min": 60.0, "hand_probability": share, "radius_max_px": 20.0}
        settings = quiet(occlusion=NOISE.occlusion.model_copy(update=changed))
        hidden = np.isnan(seen(settings, motion_ahead(750)).landmarks).any(axis=-1)
        assert hidden[:, covered].any() and (free is None or not hidden[:, free].any())


@pytest.mark.parametrize("repeated", [0.0, 1.0])
def test_lost_frames_are_empty_or_repeated(repeated):
    settings = quiet(
        frame_drops=NOISE.frame_drops.model_copy(update={"dropped_fraction": 0.1, "repeat_probability": repeated})
    )
    motion = replace(motion_ahead(1000), translation=np.linspace(0, 0.05, 1000)[:, None] * np.ones(3))
    observed = seen(settings, motion)
    empty = np.isnan(observed.landmarks).all(axis=(1, 2))
    again = np.concatenate([[False], (np.diff(observed.landmarks, axis=0) == 0).all(axis=(1, 2))])
    assert (again if repeated else empty).mean() == pytest.approx(0.1, abs=0.03)
    assert not (empty[1:] if repeated else again[1:]).any()
    assert np.array_equal(observed.confidence == 0, empty)


def test_low_resolution_makes_errors_larger_and_coordinates_coarse():
    motion = motion_ahead(200)
    exact = exact_landmarks_px(motion, camera())
    fine, coarse = (
        (seen(NOISE.model_copy(update={"resolution": share}), motion).landmarks - exact).std() for share in (1.0, 0.5)
    )
    assert coarse == pytest.approx(2 * fine, rel=0.01)
    observed = seen(quiet(resolution=0.5, quantisation_px=0.25), motion)
    assert np.allclose(observed.landmarks / 0.5, np.round(observed.landmarks / 0.5))
    assert np.abs(observed.landmarks - exact).max() <= 0.25 + 1e-9


def test_observation_keeps_head_information(tmp_path):
    observed = seen(NOISE, identity=SOMEBODY)
    observed.save(tmp_path / "seen.npz")
    assert Observation.load(tmp_path / "seen.npz").identity == SOMEBODY


@pytest.mark.parametrize(
    ("settings", "section", "changes", "message"),
    [
        (CameraSettings, SECTION["camera"], {"distance_min_m": 2.0}, "distance_max_m should be at least"),
        (NoiseSettings, SECTION["noise"], {"resolution": 0.0}, "resolution"),
        (
            corruptions.OcclusionSettings,
            SECTION["noise"]["occlusion"],
            {"radius_min_px": 99.0},
            "radius_max_px should be",
        ),
        (
            detector_noise.PupilNoiseSettings,
            SECTION["noise"]["pupil"],
            {"gain_x_min": 1.5},
            "gain_x_max should be at least",
        ),
    ],
)
def test_impossible_settings_are_errors(settings, section, changes, message):
    with pytest.raises(ValidationError, match=message):
        settings.model_validate({**section, **changes})


def test_the_camera_has_the_scale_asked_for():
    motion = Motion.of(FPS, np.zeros((1, 3)), np.zeros((1, 2, 3)))
    pupils = exact_pupils_px(motion, camera())[0]
    assert pupils[0, 0] - pupils[1, 0] == pytest.approx(62.9 * 1.154, rel=0.02)
    points = exact_landmarks_px(motion, camera())[0]
    assert points.min() > 10 and points.max() < 214
    assert points[:, 1].min() + points[:, 1].max() == pytest.approx(224, abs=8)


def test_pupil_noise_is_slow_and_hidden_by_lids():
    motion = motion_ahead(400)
    motion = replace(motion, lid=np.where(np.arange(400)[:, None] < 20, 0.9, 0.0) * np.ones((1, 2)))
    exact = exact_pupils_px(motion, camera())
    errors = np.stack([observe(motion, camera(), NOISE, np.random.default_rng(i)).pupils - exact for i in range(60)])
    assert np.isnan(errors[:, :20]).all() and not np.isnan(errors[:, 20:]).any()
    errors = errors[:, 20:]
    centred = errors - np.median(errors, axis=(0, 1))
    usual = np.abs(centred).max(axis=-1) < 2.5
    assert 0.95 < usual.mean() < 1.0
    step = np.median(np.abs(np.diff(errors, axis=1)))
    assert step < 0.7 * np.median(np.abs(centred))
    ahead = exact_pupils_px(replace(motion, gaze=0 * motion.gaze), camera())
    gain = 1 + np.median(errors, axis=(0, 1, 2)) / (exact - ahead)[0, 0]
    assert gain == pytest.approx([0.96, 0.875], abs=0.05)
    bias = np.median(errors, axis=1)
    assert np.corrcoef(bias[:, 0, 0], bias[:, 1, 0])[0, 1] > 0.25


def test_autoregressive_noise_is_stationary_at_any_rate():
    for fps in (25.0, 100.0):
        drawn = detector_noise.autoregressive((400, 500), 0.5, 0.95, fps, np.random.default_rng(0))
        assert drawn[0].std() == pytest.approx(0.5, rel=0.1) and drawn[-1].std() == pytest.approx(0.5, rel=0.1)
        lag = round(0.04 * fps)
        assert np.mean(drawn[:-lag] * drawn[lag:]) / np.mean(drawn**2) == pytest.approx(0.95, abs=0.02)


def test_noise_grows_with_the_head_turned():
    settings = NOISE.landmark
    exact = np.zeros((300, 40, 2))
    near, far = (
        detector_noise.noisy_landmarks(exact, np.full(300, yaw), FPS, settings, np.random.default_rng(0)).std()
        for yaw in (0.0, np.radians(30))
    )
    assert far / near == pytest.approx(1.5)
