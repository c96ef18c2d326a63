"""Controls of a stream that change while it runs: target, eye contact, state and liveliness, in stream time."""

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
from talkingeyes.animation.conversation_states import State
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.live_gaze import GazeDirection, LiveGaze
from talkingeyes.animation.live_listening import LiveListening
from talkingeyes.animation.live_stream import LiveStream, StreamFrames
from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL
from talkingeyes.animation.steps.eye_contact import CONTACT_RAD, eye_contact_fraction
from talkingeyes.animation.streaming import LiveControls, LiveModel
from talkingeyes.animation.targets import STRAIGHT_AHEAD
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.head.eyelid.gaze_controller import homogeneous
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
    return StreamFrames.concat(parts), named


def missed_deg(frames: StreamFrames, direction: GazeDirection) -> Float[ndarray, " T"]:
    """Angle between the line of sight of both eyes together and the target."""
    points = homogeneous(np.tile(direction.target_m, (len(frames), 1)))
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
    targets = homogeneous(np.tile(ASIDE.target_m, (len(found), 1)))
    both = line_of_sight.gaze_error_rad(found.head, found.gaze, targets, "world")
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
    listener = line_of_sight.target_direction_rad(found.head, STRAIGHT_AHEAD.at(np.arange(len(found)) / FPS))
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
        3.8: lambda each: each.change(gaze=GazeDirection(state="thinking")),
        4.5: lambda each: each.change(gaze=GazeDirection(eye_contact=0.9)),
    }
    expected = changed_at(live, changes)
    for sizes in ((160,), (1, 7000, 333)):
        found = changed_at(live, changes, sizes)
        assert found[1] == expected[1]
        for name in ("head", "gaze", "lid"):
            np.testing.assert_array_equal(getattr(found[0], name), getattr(expected[0], name))


@pytest.mark.parametrize("direction", [ASIDE, GazeDirection(eye_contact=0.4), GazeDirection(state="thinking")])
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


@pytest.mark.long
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


# The shares of the steps of files and their sources: animation/steps/states.py.
SHARES: dict[State, float] = {"listening": 0.95, "thinking": 0.2, "idle": 0.6}
LONGEST_FIXATION_S = 3.1  # of talkers, Lee, Badler & Badler 2002; as in test_conversation_states.py


def share_of(head: Float[ndarray, "T 3"], space: Float[ndarray, "T 2 2"]) -> float:
    return eye_contact_fraction(head, space, STRAIGHT_AHEAD.at(np.arange(len(head)) / FPS))


def longest_fixation_s(space: Float[ndarray, "T 2 2"], least_deg: float) -> float:
    """The longest time without a step of gaze between frames."""
    steps = np.degrees(np.hypot(*np.diff(space.mean(axis=1), axis=0).T))
    return float(np.diff([0, *np.flatnonzero(steps > least_deg), len(space)]).max() / FPS)


@pytest.mark.long
@pytest.mark.parametrize("sound", [speech(66.0), np.zeros(66 * SAMPLE_RATE, np.float32)], ids=["speech", "silence"])
@pytest.mark.parametrize("state", SHARES)
def test_a_state_has_its_share_of_eye_contact_over_a_minute(state: State, sound: Float[ndarray, " N"]) -> None:
    """The packaged model in a stream that changes from speaking after 5 s."""
    stream = LiveModel.load(PACKAGED_LIVE_MODEL).stream(1, CALM)
    parts = [stream.push(sound[: 5 * SAMPLE_RATE])]
    start = stream.change(gaze=GazeDirection(state=state)) + WITHIN
    parts += [stream.push(sound[at : at + SAMPLE_RATE]) for at in range(5 * SAMPLE_RATE, len(sound), SAMPLE_RATE)]
    head, gaze = (np.concatenate([getattr(part, name) for part in parts]) for name in ("head", "gaze"))
    minute = slice(start, start + round(60 * FPS))
    head, space = head[minute], rotation.gaze_in_space(head, gaze)[minute]
    assert len(head) == 60 * FPS
    assert share_of(head, space) == pytest.approx(SHARES[state], abs=0.07)
    assert longest_fixation_s(space, 0.2) < LONGEST_FIXATION_S
    speed = np.degrees(np.linalg.norm(np.diff(head, axis=0), axis=1)) * FPS
    assert np.convolve(speed < 0.2, np.ones(int(FPS)), "valid").max() < FPS  # the head never rests for a second


def test_a_state_takes_effect_within_200_ms_and_ends(live: LiveModel) -> None:
    changes = {
        1.5: lambda each: each.change(gaze=GazeDirection(eye_contact=0.0)),
        2.5: lambda each: each.change(gaze=GazeDirection(state="listening")),
        3.5: lambda each: each.change(gaze=GazeDirection(state="thinking")),
        4.5: lambda each: each.change(gaze=GazeDirection(state="speaking")),
    }
    found, (_, listens, thinks, speaks) = changed_at(live, changes)
    plain, _ = changed_at(live, {})
    before, _ = changed_at(live, dict(list(changes.items())[:1]))
    for name in ("head", "gaze", "lid"):  # what was given before is not changed
        np.testing.assert_array_equal(getattr(found, name)[:listens], getattr(before, name)[:listens])
    spaces = [rotation.gaze_in_space(each.head, each.gaze) for each in (found, plain)]
    listener = line_of_sight.target_direction_rad(found.head, STRAIGHT_AHEAD.at(np.arange(len(found)) / FPS))
    away = np.hypot(*(line_of_sight.cyclopean_line_of_sight_rad(spaces[0]) - listener).T)
    assert away[listens - 1] > CONTACT_RAD
    assert away[listens + WITHIN - 1 : listens + 2 * WITHIN].max() < CONTACT_RAD
    assert away[thinks + WITHIN - 1] > CONTACT_RAD
    np.testing.assert_allclose(*(each[speaks + WITHIN :].mean(axis=1) for each in spaces), atol=1e-5)
    np.testing.assert_allclose(found.head[speaks + 25 :], plain.head[speaks + 25 :], atol=1e-6)


def test_while_thinking_the_head_moves_half_as_much_and_a_target_precedes(live: LiveModel) -> None:
    """With the same target, the only difference is the head."""
    direction = GazeDirection(target_m=ASIDE.target_m, state="thinking")
    changes = {2.0: lambda each: each.change(gaze=ASIDE), 4.0: lambda each: each.change(gaze=direction)}
    found, (_, thinks) = changed_at(live, changes)
    other, _ = changed_at(live, dict(list(changes.items())[:1]))
    plain, _ = changed_at(live, {})
    np.testing.assert_array_equal(found.head[:thinks], other.head[:thinks])
    start = thinks + WITHIN - 1
    np.testing.assert_allclose(
        (other.head - found.head)[start:], 0.5 * (plain.head - live.mean_head)[start:], atol=1e-12
    )
    assert np.abs(plain.head - live.mean_head)[start:].max() > 0.02
    assert missed_deg(found, direction)[thinks:].max() < 0.01


@pytest.mark.parametrize("state", SHARES)
def test_eye_contact_that_was_set_precedes_a_state(state: State) -> None:
    for fraction in (0.0, 0.5, 1.0):
        directions = [GazeDirection(eye_contact=fraction, state=each) for each in (state, None)]
        shares = []
        for direction in directions:
            found = LiveGaze(FPS, np.zeros(3), [0]).direct(person(0, 60.0), direction)
            shares.append(share_of(found.head, found.gaze_in_space_rad))
        assert shares == pytest.approx([fraction, fraction], abs=0.07)


@pytest.mark.parametrize("away_deg", [0.0, 10.0])
@pytest.mark.parametrize("state", SHARES)
def test_a_motionless_model_does_not_freeze_outside_speech(state: State, away_deg: float) -> None:
    still = np.zeros((round(60 * FPS), 2, 2)) + line_of_sight.MEAN_KAPPA_RAD + [np.radians(away_deg), 0.0]
    own = GazeTrajectory(FPS, np.zeros((len(still), 3)), still, ())

    def directed(state: State, liveliness: float = 1.0) -> Float[ndarray, "T 2 2"]:
        return LiveGaze(FPS, np.zeros(3), [3]).direct(own, GazeDirection(state=state), liveliness).gaze_in_space_rad

    found = directed(state)
    assert longest_fixation_s(found, 0.02) < LONGEST_FIXATION_S
    assert share_of(own.head, found) == pytest.approx(SHARES[state], abs=0.07)
    assert longest_fixation_s(directed("speaking"), 0.02) == 60.0
    scans = [
        np.count_nonzero(np.hypot(*np.diff(each.mean(axis=1), axis=0).T) > 1e-4)
        for each in (found, directed(state, 0.0))
    ]
    assert scans[1] < scans[0]


def test_thinking_looks_up_or_aside_more_than_down() -> None:
    away = []
    for seed in range(6):
        found = LiveGaze(FPS, np.zeros(3), [seed]).direct(person(seed, 60.0), GazeDirection(state="thinking"))
        away.append(np.degrees(line_of_sight.cyclopean_line_of_sight_rad(found.gaze_in_space_rad)))
    gaze = np.concatenate(away)
    gaze = gaze[np.hypot(*gaze.T) > 5.0]
    assert ((gaze[:, 1] < 0) & (np.abs(gaze[:, 1]) > np.abs(gaze[:, 0]))).mean() < 0.4  # Andrist et al. 2013: 0.29


def test_frames_do_not_depend_on_later_ones() -> None:
    own = person(1, 20.0)
    half = GazeTrajectory(FPS, own.head[:250], own.gaze_in_space_rad[:250], ())
    for direction in (GazeDirection(state="idle"), GazeDirection(eye_contact=0.5)):
        found = [LiveGaze(FPS, np.zeros(3), [0]).direct(each, direction) for each in (own, half)]
        np.testing.assert_array_equal(found[0].gaze_in_space_rad[:250], found[1].gaze_in_space_rad)
        np.testing.assert_array_equal(found[0].head[:250], found[1].head)


def test_an_unknown_state_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"^state: should be one of speaking, listening, thinking, idle, got asleep$"):
        GazeDirection(state="asleep")


def conversation(chunk: int, seed: int) -> list[float | None]:
    """Contact at 25 fps where the partner speaks from 1 s to 13 s, and the subject after it."""
    times = np.arange(20 * SAMPLE_RATE) / SAMPLE_RATE
    noise = np.random.default_rng(0).standard_normal((2, len(times))) * np.where((times * 3) % 1 < 0.8, 1.0, 0.1)
    voiced = np.stack([times > 14.0, (times > 1.0) & (times < 13.0)])
    own, partner = ((0.2 * voiced + 1e-4) * noise).astype(np.float32)
    listening, found = LiveListening(FPS, 0.2, "face_to_face", [seed]), []
    for start in range(0, len(times), chunk):
        listening.push(own[start : start + chunk], partner[start : start + chunk])
        ready = int(((start + chunk) / SAMPLE_RATE - 0.2) * FPS) - len(found)
        found += listening.contact(max(0, ready))
    return found


def test_a_stream_looks_at_the_partner_who_speaks_as_recorded_people_do() -> None:
    shares = []
    for seed in range(40):
        found = conversation(SAMPLE_RATE, seed)
        assert set(found[: round(0.8 * FPS)]) == {None}
        assert set(found[round(14.3 * FPS) :]) == {None}  # the subject speaks
        turn = found[round(1.5 * FPS) : round(12.5 * FPS)]
        assert set(turn) <= {0.0, 1.0}
        shares.append(np.mean(np.array(turn) == 0.0))
    assert 0.15 < np.mean(shares) < 0.33  # recorded face to face: 0.19 to 0.28
    assert np.std(shares) > 0.1
    assert conversation(640, 3) == conversation(SAMPLE_RATE, 3)


def test_gaze_with_a_partner_does_not_depend_on_chunks() -> None:
    model, times = LiveModel.load(PACKAGED_LIVE_MODEL), np.arange(5 * SAMPLE_RATE) / SAMPLE_RATE
    noise = 0.2 * np.random.default_rng(0).standard_normal(len(times))
    own, partner = (noise * part for part in (times < 1.0, (times % 1.8 < 1.2) & (times > 1.5)))
    sounds = [each.astype(np.float32) for each in (own, partner)]
    whole = model.generate_offline(sounds[0], 1, partner=sounds[1])
    assert np.abs(whole.gaze - model.generate_offline(sounds[0], 1).gaze).max() > 0.02
    stream = model.stream(1)
    parts = [stream.push(*(each[start : start + 1111] for each in sounds)) for start in range(0, len(times), 1111)] + [
        stream.finish()
    ]
    np.testing.assert_allclose(np.concatenate([part.gaze for part in parts]), whole.gaze, atol=1e-5)


def test_contact_of_a_listener_directs_gaze_unless_something_else_does() -> None:
    own = person(0, 20.0)
    frames = len(own.head)
    for wanted in (0.0, 1.0):
        found = LiveGaze(FPS, np.zeros(3), [0]).direct(own, GazeDirection(), 1.0, [wanted] * frames)
        assert share_of(found.head, found.gaze_in_space_rad) == pytest.approx(wanted, abs=0.1)
    target = GazeDirection(target_m=ASIDE.target_m)
    plain, other = (LiveGaze(FPS, np.zeros(3), [0]).direct(own, target, 1.0, each) for each in ((), [1.0] * frames))
    np.testing.assert_array_equal(plain.gaze_in_space_rad, other.gaze_in_space_rad)
