"""Controls of a stream that change while it runs: target, eye contact and liveliness, in stream time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from jaxtyping import Float
from live_model import write_live_model
from numpy import ndarray
from test_streaming import close, speech, streamed

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.controls import Liveliness
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.live_gaze import GazeDirection, LiveGaze
from talkingeyes.animation.steps.eye_contact import CONTACT_RAD, eye_contact_fraction
from talkingeyes.animation.streaming import LiveControls, LiveModel, LiveStream, StreamFrames
from talkingeyes.animation.targets import STRAIGHT_AHEAD
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.physiology.saccades import sample_saccade

FPS, WITHIN_S = 25.0, 0.2
WITHIN = round(WITHIN_S * FPS)
CALM = LiveControls("paper", Liveliness(blinks=0.0))  # without blinks, which hold gaze
ASIDE = GazeDirection(target_m=(0.5, 0.1, 1.0))


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> LiveModel:
    return LiveModel.load(write_live_model(tmp_path_factory.mktemp("live") / "model"))


def changed_at(
    live: LiveModel,
    changes: dict[float, Callable[[LiveStream], int]],
    sizes: tuple[int, ...] = (640,),
    controls: LiveControls = CALM,
    seconds: float = 6.0,
) -> tuple[StreamFrames, list[int]]:
    """A stream whose controls are changed when so much sound was sent; and the frames that it names."""
    sound, stream, parts, named, start, turn = speech(seconds), live.stream(4, controls), [], [], 0, 0
    moments = [*(round(second * SAMPLE_RATE) for second in changes), len(sound)]
    for moment, change in zip(moments, [*changes.values(), None], strict=True):
        while start < moment:
            stop = min(start + sizes[turn % len(sizes)], moment)
            parts.append(stream.push(sound[start:stop]))
            start, turn = stop, turn + 1
        if change is not None:
            named.append(change(stream))
    parts.append(stream.finish())
    names = ("head", "gaze", "lid")
    return StreamFrames(0, *(np.concatenate([getattr(part, name) for part in parts]) for name in names)), named


def missed_deg(frames: StreamFrames, direction: GazeDirection) -> Float[ndarray, " T"]:
    """Angle between the line of sight of both eyes together and the target."""
    points = np.tile(np.array(direction.target_m), (len(frames), 1))
    wanted = line_of_sight.optical_axes_rad(frames.head, points, "world").mean(axis=1)
    space = rotation.gaze_in_space(frames.head, frames.gaze).mean(axis=1)
    return np.degrees(np.hypot(*(space - wanted).T))


def test_a_target_is_looked_at_within_200_ms_and_left_again(live: LiveModel) -> None:
    free = {2.0: lambda each: each.change(gaze=ASIDE), 4.0: lambda each: each.change(gaze=GazeDirection())}
    found, (on, off) = changed_at(live, free)
    plain, _ = changed_at(live, {})
    for name in ("head", "gaze", "lid"):  # what was given before is not changed
        np.testing.assert_array_equal(getattr(found, name)[:on], getattr(plain, name)[:on])
    assert 2.0 - on / FPS <= live.latency_s + 2 / FPS  # the next frame that is due
    missed = missed_deg(found, ASIDE)
    assert missed[on - 1] > 10.0
    assert missed[on + WITHIN - 1 : off].max() < 0.01
    both = line_of_sight.gaze_error_rad(found.head, found.gaze, np.tile(ASIDE.target_m, (len(found), 1)), "world")
    assert np.degrees(both[on + 25 : off]).max() < 0.1  # vergence has followed
    turned = np.degrees(rotation.direction_to_angles(rotation.rotvec_to_direction(found.head - plain.head)))
    assert abs(turned[on + WITHIN - 1, 0]) > 0.3  # the head has started
    assert turned[off - 1, 0] > 5.0  # and took its part
    space = [rotation.gaze_in_space(each.head, each.gaze).mean(axis=1) for each in (found, plain)]
    np.testing.assert_allclose(space[0][off + WITHIN :], space[1][off + WITHIN :], atol=1e-5)
    np.testing.assert_allclose(found.head[off + 25 :], plain.head[off + 25 :], atol=1e-6)


def test_eye_contact_is_made_and_broken_within_200_ms(live: LiveModel) -> None:
    changes = {
        1.5: lambda each: each.change(gaze=GazeDirection(eye_contact=1.0)),
        3.0: lambda each: each.change(gaze=GazeDirection(eye_contact=0.0)),
    }
    found, (made, broken) = changed_at(live, changes)
    space = rotation.gaze_in_space(found.head, found.gaze)
    listener = line_of_sight.point_direction_rad(found.head, STRAIGHT_AHEAD.at(np.arange(len(found)) / FPS))
    away = np.hypot(*(line_of_sight.cyclopean_line_of_sight_rad(space) - listener).T)
    assert away[made + WITHIN - 1 : broken].max() < CONTACT_RAD
    assert away[broken + WITHIN - 1] > CONTACT_RAD
    assert (away[broken + WITHIN :] > CONTACT_RAD).mean() > 0.97  # saccades from side to side cross the face


def test_liveliness_changes_within_200_ms_and_without_a_jump(live: LiveModel) -> None:
    found, (at,) = changed_at(live, {2.0: lambda each: each.change(Liveliness(head=0.0, gaze=0.5, blinks=0.0))})
    plain, _ = changed_at(live, {})
    calm, _ = changed_at(live, {}, controls=LiveControls("paper", Liveliness(head=0.0, gaze=0.5, blinks=0.0)))
    np.testing.assert_array_equal(found.head[:at], plain.head[:at])
    np.testing.assert_allclose(found.head[at + WITHIN - 1 :], calm.head[at + WITHIN - 1 :], atol=1e-12)
    np.testing.assert_allclose(found.gaze[at + WITHIN - 1 :], calm.gaze[at + WITHIN - 1 :], atol=1e-12)
    assert np.abs(plain.head[at + WITHIN] - found.head[at + WITHIN]).max() > 1e-3
    most = np.abs(np.diff(plain.head, axis=0)).max() + np.abs(plain.head - calm.head).max() / 2
    assert np.abs(np.diff(found.head, axis=0)).max() < most


def test_changes_do_not_depend_on_chunks(live: LiveModel) -> None:
    changes = {
        1.5: lambda each: each.change(Liveliness(head=2.0), GazeDirection(eye_contact=0.3)),
        3.0: lambda each: each.change(gaze=ASIDE),
        4.5: lambda each: each.change(gaze=GazeDirection(eye_contact=0.9)),
    }
    expected = changed_at(live, changes)
    for sizes in ((160,), (1, 7000, 333)):
        found = changed_at(live, changes, sizes)
        assert found[1] == expected[1]
        for name in ("head", "gaze", "lid"):
            np.testing.assert_array_equal(getattr(found[0], name), getattr(expected[0], name))


@pytest.mark.parametrize("direction", [ASIDE, GazeDirection(eye_contact=0.4)])
def test_a_directed_stream_is_what_the_whole_speech_gives(live: LiveModel, direction: GazeDirection) -> None:
    controls = LiveControls(gaze=direction)
    close(streamed(live, speech(), [640], 1, controls), live.generate_offline(speech(), 1, controls))


def person(seed: int, seconds: float = 120.0) -> GazeTrajectory:
    """A person whose fixations lie about the partner, in frames."""
    rng, times = np.random.default_rng(seed), np.arange(round(seconds * FPS)) / FPS
    gaze, onset, path = np.zeros(2), 0.4, np.zeros((len(times), 2))
    while onset < seconds:
        goal = np.radians(rng.normal(0, [7.0, 4.0]))
        jump = sample_saccade(onset, gaze, goal, rng)
        path[times >= onset] = jump.end_rad
        gaze, onset = np.array(jump.end_rad), onset + rng.uniform(0.4, 1.6)
    return GazeTrajectory(FPS, np.zeros((len(times), 3)), path[:, None] + line_of_sight.MEAN_KAPPA_RAD, ())


@pytest.mark.parametrize("fraction", [0.0, 0.2, 0.5, 0.8, 1.0])
def test_the_share_of_eye_contact_is_met(fraction: float) -> None:
    found = []
    for seed in range(4):
        directed = LiveGaze(FPS, np.zeros(3), [seed]).direct(person(seed), GazeDirection(eye_contact=fraction))
        listener = STRAIGHT_AHEAD.at(directed.times_s)
        found.append(eye_contact_fraction(directed.head, directed.gaze_in_space_rad, listener))
    assert np.mean(found) == pytest.approx(fraction, abs=0.07)


def test_without_direction_nothing_is_changed() -> None:
    own = person(0, 10.0)
    found = LiveGaze(FPS, np.zeros(3), [0]).direct(own, GazeDirection())
    np.testing.assert_array_equal(found.head, own.head)
    np.testing.assert_array_equal(found.gaze_in_space_rad, own.gaze_in_space_rad)
