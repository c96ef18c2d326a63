"""Targets: reading of tracks and errors; gaze on target with main sequence saccades, vergence and head contribution."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from toy_performer import motion, perform_toy

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.targets import ObjectTrack, Target, TargetTrack, constant_target, load_targets
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import gaze_in_space_speed_deg_s
from talkingeyes.physiology import saccades

LAMP, CUP = ObjectTrack.fixed(0.9, 0.3, 1.2), ObjectTrack.fixed(-0.15, -0.2, 0.4)
CAR = ObjectTrack((8.0, 12.0), ((-1.0, 0.0, 2.0, 1.0), (1.0, 0.2, 2.0, 1.0)))
TRACK = TargetTrack(
    (Target(2.0, 4.0, "lamp"), Target(4.0, 6.0, "cup"), Target(8.0, 12.0, "car"), Target(15.0, 16.5, "listener")),
    {"lamp": LAMP, "cup": CUP, "car": CAR},
)


@pytest.mark.parametrize("fps", [25.0, 120.0])
def test_lines_of_sight_meet_at_the_target(fps: float) -> None:
    made = motion(fps=fps, targets=TRACK)
    times = np.arange(len(made)) / fps
    for target in TRACK.targets:
        object_track = TRACK.object_track(target.name).at(times)
        on = (times >= target.start_s + 1.0) & (times < target.end_s - 0.05)
        miss = np.degrees(line_of_sight.gaze_error_rad(made.head, made.gaze, object_track, "world"))
        assert miss[on].max() < 0.25
        landed = (times >= target.start_s + 0.4) & (times < target.end_s - 0.05)  # vergence is slower
        both = line_of_sight.cyclopean_line_of_sight_rad(rotation.gaze_in_space(made.head, made.gaze))
        beside = np.degrees(np.hypot(*(both - line_of_sight.target_direction_rad(made.head, object_track)).T))
        assert beside[landed].max() < 1.0
        off = (times >= target.end_s + 1.0) & (times < target.end_s + 1.5)
        assert target.name == "lamp" or miss[off].max() > 2.0


def test_eyes_converge_by_the_distance() -> None:
    for distance in (0.3, 0.6, 2.0):
        track = TargetTrack((Target(1.0, 5.0, "it"),), {"it": ObjectTrack.fixed(0.0, 0.0, distance)})
        made = motion(targets=track)
        sight_rad = rotation.gaze_to_angles(made.gaze) - line_of_sight.MEAN_KAPPA_RAD
        vergence = np.degrees(sight_rad[:, 1, 0] - sight_rad[:, 0, 0])[75:120].mean()
        assert vergence == pytest.approx(np.degrees(2 * np.arctan(0.03145 / distance)), rel=0.1)


@pytest.mark.parametrize("fps", [60.0, 120.0])
def test_saccades_to_targets_keep_the_main_sequence(fps: float) -> None:
    (made,) = perform_toy(fps=fps, targets=TRACK)
    speed = gaze_in_space_speed_deg_s(made.motion.head, made.motion.gaze, fps)
    checked = 0
    for each in made.events.saccades:
        size = float(np.hypot(*np.subtract(each.end_rad, each.start_rad)))
        if any(each.onset_s == target.start_s for target in TRACK.targets) and size > np.radians(3):
            assert each.duration_s == pytest.approx(float(saccades.duration_s(size)))
            law = float(np.degrees(saccades.peak_speed(size)))
            around = slice(int(each.onset_s * fps), int((each.onset_s + each.duration_s) * fps) + 2)
            assert 0.75 * law < speed[around].max() < 1.15 * law
            checked += 1
    assert checked >= 3


def test_between_targets_gaze_is_that_of_the_model() -> None:
    own, made = motion(), motion(targets=TRACK)
    times = np.arange(len(own)) / 25
    free = (times < 1.8) | ((times > 20.0) & (times < 29.0))
    spaces = [rotation.gaze_in_space(each.head, each.gaze)[free] for each in (own, made)]
    np.testing.assert_allclose(*spaces, atol=np.radians(0.1))
    np.testing.assert_allclose(own.head[free], made.head[free], atol=np.radians(0.1))


def test_head_contributes_and_eyes_stay_within_range() -> None:
    track = TargetTrack(
        (Target(2.0, 6.0, "door"),), {"door": ObjectTrack.fixed(3.0, 0.0, 1.0)}
    )  # 72 degrees to the left
    made = motion(targets=track)
    head_yaw = np.degrees(rotation.gaze_to_angles(made.head)[75:145, 0])
    eye_yaw = np.degrees(rotation.gaze_to_angles(made.gaze)[75:145, :, 0])
    assert 40 < head_yaw.min() < head_yaw.max() < 65
    assert eye_yaw.max() < 29.6
    assert (
        np.degrees(
            line_of_sight.gaze_error_rad(made.head, made.gaze, track.object_track("door").at(np.zeros(750)), "world")
        )[80:145].max()
        < 0.3
    )


def test_a_target_in_the_heads_frame_goes_with_the_head() -> None:
    track = TargetTrack((Target(1.0, 20.0, "brim"),), {"brim": ObjectTrack.fixed(0.05, 0.1, 0.5)}, "head")
    made = motion(targets=track)
    miss = np.degrees(
        line_of_sight.gaze_error_rad(made.head, made.gaze, track.object_track("brim").at(np.zeros(len(made))), "head")
    )
    assert miss[60:490].max() < 0.1
    np.testing.assert_array_equal(made.head, motion().head)


def test_targets_beyond_the_sound_change_nothing() -> None:
    own, made = motion(), motion(targets=TargetTrack((Target(40.0, 50.0, "camera"),)))
    np.testing.assert_allclose(own.gaze, made.gaze, atol=1e-12)


JSON = {
    "schema": "talkingeyes.targets/1",
    "objects": {"lamp": [0.9, 0.3, 1.2], "car": {"times_s": [0, 2], "positions_m": [[-1, 0, 2], [1, 0, 2]]}},
    "targets": [
        {"start_s": 1, "end_s": 2.5, "at": "lamp"},
        {"start_s": 3, "at": [0.1, 0, 0.7]},
        {"start_s": 4, "at": "camera"},
    ],
}
AT_INFINITY = "start_s,end_s,name,x_m,y_m,z_m,w\n1,2.5,,2,0,4,0\n3,,,2,0,4,2\n"
CSV = "start_s,end_s,name,x_m,y_m,z_m\n1,2.5,lamp,0.9,0.3,1.2\n3,,,0.1,0,0.7\n4,,camera,,,\n"


def test_json_and_csv_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(JSON))
    (tmp_path / "a.csv").write_text(CSV)
    one, other = load_targets(tmp_path / "a.json"), load_targets(tmp_path / "a.csv")
    assert one.targets == other.targets
    assert [(each.start_s, each.end_s) for each in one.targets] == [(1, 2.5), (3, 4), (4, np.inf)]
    for target in one.targets:
        assert one.object_track(target.name) == other.object_track(target.name)
    assert one.object_track("car").at(np.array([1.0])).tolist() == [[0, 0, 2, 1]]
    assert one.object_track("camera").positions[0][2] > 0


def test_at_infinity_the_lines_of_sight_are_parallel(tmp_path: Path) -> None:
    """With w = 0; a point with w = 2 is at half its coordinates."""
    (tmp_path / "a.csv").write_text(AT_INFINITY)
    track = load_targets(tmp_path / "a.csv")
    assert track.object_track("target 2").positions == ((1.0, 0.0, 2.0, 1.0),)
    made = motion(targets=track)
    left, right = rotation.gaze_to_angles(made.gaze[60]) - line_of_sight.MEAN_KAPPA_RAD
    np.testing.assert_allclose(np.degrees(left), np.degrees(right), atol=0.1)  # vergence has followed
    sight = line_of_sight.cyclopean_line_of_sight_rad(rotation.gaze_in_space(made.head, made.gaze))[60]
    np.testing.assert_allclose(np.degrees(sight), [np.degrees(np.arctan2(2, 4)), 0.0], atol=0.5)
    near = np.tile(track.object_track("target 2").positions, (len(made), 1))
    assert np.degrees(line_of_sight.gaze_error_rad(made.head, made.gaze, near, "world")[100:].max()) < 0.1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"schema": "other/1"}, "schema should be"),
        ({"frame": "room"}, "frame should be world or head, got room"),
        ({"extra": 1}, "got extra"),
        ({"targets": [], "objects": {}}, "at least one target"),
        ({"targets": [{"start_s": 1}]}, "target 1 should have start_s, at"),
        ({"targets": [{"start_s": "x", "at": "lamp"}]}, "should be a number, got 'x'"),
        ({"targets": [{"start_s": float("nan"), "at": "lamp"}]}, "finite number"),
        ({"targets": [{"start_s": -1, "at": "lamp"}]}, "target 1 should start at 0 s or later"),
        ({"targets": [{"start_s": 2, "end_s": 1, "at": "lamp"}]}, "target 1 should start"),
        ({"targets": [{"start_s": 2, "end_s": 5, "at": "lamp"}, {"start_s": 3, "at": "lamp"}]}, "before the next"),
        ({"targets": [{"start_s": 1, "at": "cat"}]}, "one of camera, listener, lamp, car, got cat"),
        ({"targets": [{"start_s": 1, "at": [0, 0, -1]}]}, "within 75 degrees"),
        ({"targets": [{"start_s": 1, "at": [0, 0, 0.01]}]}, "0.15 m"),
        ({"targets": [{"start_s": 1, "at": [0, 0]}]}, r"positions \[x, y, z\]"),
        ({"targets": [{"start_s": 1, "at": [0, 0, 0, 0]}]}, "a direction for w = 0"),
        ({"targets": [{"start_s": 1, "at": [0, 0, 1, -1]}]}, "w of 0 or more"),
        ({"targets": [{"start_s": 1, "at": [1, 0, 0, 0]}]}, "within 75 degrees"),
        ({"objects": {"lamp": {"times_s": [2, 1], "positions_m": [[0, 0, 1], [0, 0, 1]]}}}, "ascending times_s"),
        ({"frame": "head", "objects": {"lamp": [1, 0, 1], "car": [0, 0, 1]}}, "within 20 degrees"),
    ],
)
def test_bad_track_is_one_line_error(tmp_path: Path, change: dict, says: str) -> None:
    path = tmp_path / "track.json"
    path.write_text(json.dumps(JSON | change))
    with pytest.raises(InputError, match=says) as caught:
        load_targets(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["{", "[1]", "", "start_s,end_s\n1,2\n", "\x00\xff"])
def test_invalid_track_file_is_one_line_error(tmp_path: Path, text: str) -> None:
    for name in ("t.json", "t.csv"):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=name):
            load_targets(tmp_path / name)
    with pytest.raises(InputError, match="readable track"):
        load_targets(tmp_path / "none.json")


def test_bare_name_is_a_target_throughout() -> None:
    made = motion(targets=constant_target("camera"))
    ahead = np.tile([0.0, 0.0, 1.0, 1.0], (len(made), 1))
    assert np.degrees(line_of_sight.gaze_error_rad(made.head, made.gaze, ahead, "world")).max() < 0.1
    with pytest.raises(InputError, match="camera, listener or a file"):
        constant_target("moon")
