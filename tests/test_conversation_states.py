"""States: tracks, states from sound, what the packaged default model does in each, and the reasons of gaze shifts.

Bounds are those of people, with their sources; `animation/steps/states.py` has the rules.
"""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from command_line import call
from toy_performer import PERFORMER, SOUND, perform_toy

from talkingeyes.animation.animation import Animation
from talkingeyes.animation.controls import Controls, Liveliness
from talkingeyes.animation.conversation_states import (
    STATES,
    StateTrack,
    load_states,
    resolve_states,
    states_of_turns,
    with_states,
)
from talkingeyes.animation.event_keys import load_keys
from talkingeyes.animation.model_file import PACKAGED_MODEL
from talkingeyes.animation.shift_reasons import REASONS
from talkingeyes.animation.steps.eye_contact import eye_contact_fraction
from talkingeyes.animation.targets import constant_target
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.turn_taking import detect_turns
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.workflows.animate import load_performer

SEEDS = 4
FPS = 25.0
TRACK = StateTrack(
    (Span(0.0, 7.0, "speaking"), Span(7.0, 15.0, "listening"), Span(15.0, 22.5, "thinking"), Span(22.5, 30.0, "idle"))
)


def sounds() -> tuple[np.ndarray, np.ndarray]:
    """Thirty seconds: the subject reads for 7 s, then the partner in phrases of 1.6 s for 8 s, then nobody."""
    read = read_speech(str(files("moonshine_voice") / "assets/two_cities.wav"))
    own, partner = np.zeros((2, 30 * SAMPLE_RATE), np.float32)
    own[: 7 * SAMPLE_RATE] = read[: 7 * SAMPLE_RATE]
    partner[7 * SAMPLE_RATE : 15 * SAMPLE_RATE] = read[20 * SAMPLE_RATE : 28 * SAMPLE_RATE]
    partner[np.arange(len(partner)) / SAMPLE_RATE % 2.0 > 1.6] = 0.0
    return own, partner


@pytest.fixture(scope="module")
def performer():
    return load_performer(PACKAGED_MODEL)


@pytest.fixture(scope="module")
def made(performer) -> list[Animation]:
    own, partner = sounds()
    return [performer.perform(own, 1, k, FPS, Controls(partner=partner, states=TRACK))[0] for k in range(SEEDS)]


@pytest.fixture(scope="module")
def plain(performer) -> list[Animation]:
    own, partner = sounds()
    return [performer.perform(own, 1, k, FPS, Controls(partner=partner))[0] for k in range(SEEDS)]


def span(state: str) -> Span:
    return next(each for each in TRACK.spans if each.label == state)


def frames(state: str) -> slice:
    return slice(round(span(state).start_s * FPS), round(span(state).end_s * FPS))


def contact(animation: Animation, state: str) -> float:
    head, inside = animation.motion.head, frames(state)
    space = rotation.gaze_in_space(head, animation.motion.gaze)
    return eye_contact_fraction(head[inside], space[inside], np.tile([0.0, 0.0, 1.0, 1.0], (len(head), 1))[inside])


@pytest.mark.long
def test_each_state_looks_at_the_partner_as_much_as_people_do(made, plain):
    found = {state: [contact(each, state) for each in made] for state in STATES}
    # Listening: 0.95 (Lee, Badler & Badler 2002), 0.91 (recorded people, docs/results/people.md), 0.96 (mean aversion
    # 4 %).
    assert 0.91 <= np.mean(found["listening"]) <= 0.99 and min(found["listening"]) >= 0.85
    # Thinking: 0.20 (Kendon 1967, hesitant speech). Idle: 0.61 (Argyle & Ingham 1972, all of a conversation).
    assert 0.15 <= np.mean(found["thinking"]) <= 0.32 and max(found["thinking"]) <= 0.40
    assert 0.50 <= np.mean(found["idle"]) <= 0.70
    # Speaking is the model's, which does not avert gaze of its own while it thinks.
    assert found["speaking"] == pytest.approx([contact(each, "speaking") for each in plain], abs=0.05)
    assert min(contact(each, "thinking") for each in plain) > max(found["thinking"])


def test_thinking_looks_up_or_aside_more_than_down(made):
    offsets = []
    for each in made:
        space = np.degrees(rotation.cyclopean_gaze(rotation.gaze_in_space(each.motion.head, each.motion.gaze)))
        offsets.append(space[frames("thinking")])
    away = np.concatenate(offsets)
    away = away[np.hypot(*away.T) > 5.0]
    down = (away[:, 1] < 0) & (np.abs(away[:, 1]) > np.abs(away[:, 0]))
    assert down.mean() < 0.5  # Andrist et al. 2013: 0.29


def test_the_head_moves_less_while_thinking(made, plain):
    def speed(animation: Animation) -> float:
        return float(np.linalg.norm(np.diff(animation.motion.head[frames("thinking")], axis=0), axis=1).mean())

    ratios = [speed(one) / speed(other) for one, other in zip(made, plain, strict=True)]
    assert np.median(ratios) < 0.9


@pytest.mark.parametrize("state", ["listening", "thinking", "idle"])
def test_no_state_freezes(made, state):
    """Saccades are no further apart than the mean dwell of talkers (3.1 s, Lee et al. 2002); the head never rests."""
    blinks = 0
    for each in made:
        inside = frames(state)
        onsets = [s.onset_s for s in each.events.saccades if span(state).start_s <= s.onset_s < span(state).end_s]
        assert np.diff([span(state).start_s, *onsets, span(state).end_s]).max() < 3.1
        speed = np.degrees(np.linalg.norm(np.diff(each.motion.head[inside], axis=0), axis=1)) * FPS
        still = np.convolve(speed < 0.2, np.ones(int(FPS)), "valid")
        assert still.max() < FPS
        blinks += sum(span(state).start_s <= blink.onset_s < span(state).end_s for blink in each.events.blinks)
    minutes = SEEDS * (span(state).end_s - span(state).start_s) / 60
    assert 8 <= blinks / minutes <= 45  # 95 % of people, Bentivoglio 1997 and Doughty 2001


def test_a_motionless_model_still_scans_outside_speech():
    """The rule alone: a generator whose gaze rests for seconds gets scanning saccades in all states but speaking."""
    track = StateTrack((Span(0.0, 15.0, "speaking"), Span(15.0, 30.0, "idle")))
    with_track, without = perform_toy(states=track)[0], perform_toy()[0]
    counts = [
        [sum(lo <= each.onset_s < lo + 15 for each in one.events.saccades) for lo in (0, 15)]
        for one in (with_track, without)
    ]
    assert counts[0][0] == pytest.approx(counts[1][0], abs=2)
    assert counts[0][1] > counts[1][1]
    still = perform_toy(states=track, liveliness=Liveliness(gaze=0.0))[0]
    assert len(still.events.saccades) <= len(with_track.events.saccades)


def test_nods_follow_the_ends_of_the_partner_s_phrases(performer):
    own, partner = sounds()
    turns = detect_turns(own, partner)
    ends_s = [each.end_s for each in turns.partner]
    assert len(ends_s) >= 3
    nods, controls = [], Controls(partner=partner, states=TRACK)
    for seed in range(20):
        context = performer._context(own, controls, None, seed).for_sample(0)
        strokes = context.listening.nods
        follow = [after.onset_s - before.onset_s - before.duration_s < 1e-6 for before, after in pairwise(strokes)]
        nods += [each.onset_s for each, same in zip(strokes, [False, *follow], strict=True) if not same]
    first_after = [min(time - end for end in ends_s if end <= time) for time in nods]
    assert len(nods) > 20
    assert min(first_after) >= 0.1 and max(first_after) <= 0.5  # the first stroke of each nod


def test_every_shift_has_a_reason_and_looks_away_for_one(made, tmp_path):
    for each in made:
        assert [one.onset_s for one in each.reasons] == [one.onset_s for one in each.events.saccades]
        assert {one.reason for one in each.reasons} <= set(REASONS)
        for one in each.reasons:
            assert span(one.state).start_s <= one.onset_s < span(one.state).end_s
        away = [one for one in each.reasons if one.reason not in ("return", "scan")]
        allowed = {"thinking": {"thinking"}, "idle": {"idle"}, "listening": {"intimacy", "turn start"}}
        assert all(one.reason in allowed.get(one.state, set(REASONS)) for one in away)
    reasons = {one.reason for each in made for one in each.reasons}
    assert {"return", "scan", "thinking", "idle", "intimacy"} <= reasons
    made[0].save(tmp_path / "a.npz")
    content = json.loads((tmp_path / "a.events.json").read_text())
    assert [one["reason"] for one in content["reasons"]] == [one.reason for one in made[0].reasons]
    assert [one["onset_s"] for one in content["reasons"]] == [one["onset_s"] for one in content["saccades"]]
    assert load_keys(tmp_path / "a.events.json").original.saccades  # edits still work


@pytest.mark.long
def test_looking_away_at_speech_has_the_reason_of_its_moment(performer):
    """Own phrases with a short and a long pause, after the partner; eye contact by rule makes shifts everywhere."""
    read = read_speech(str(files("moonshine_voice") / "assets/two_cities.wav"))
    own, partner = np.zeros((2, 30 * SAMPLE_RATE), np.float32)
    partner[: 5 * SAMPLE_RATE] = read[: 5 * SAMPLE_RATE]
    for start, end in ((6, 14), (15, 22), (22.4, 30)):
        own[round(start * SAMPLE_RATE) : round(end * SAMPLE_RATE)] = read[
            round(start * SAMPLE_RATE) : round(end * SAMPLE_RATE)
        ]
    found = {
        one.reason
        for seed in range(8)
        for one in performer.perform(own, 1, seed, FPS, Controls(partner=partner, states="auto"))[0].reasons
        if one.reason not in ("return", "scan")
    }
    assert "turn start" in found and found & {"hesitation", "planning", "thinking"}
    controlled = performer.perform(own, 1, 0, FPS, Controls(partner=partner, eye_contact=0.5))[0]
    assert {one.reason for one in controlled.reasons} <= {"return", "scan", "control"}
    aimed = performer.perform(own, 1, 0, FPS, Controls(targets=constant_target("camera")))[0]
    assert "intimacy" not in {one.reason for one in aimed.reasons}


def test_states_from_sound():
    own = (Span(4.0, 6.0), Span(6.8, 9.0), Span(9.2, 10.0), Span(16.0, 18.0))
    turns = Annotation(
        speaking=own, listening=(Span(0.0, 2.0), Span(10.5, 14.0)), partner=(Span(0.0, 1.5), Span(10.5, 13.5))
    )
    states = states_of_turns(turns, 22.0)
    assert states[0].start_s == 0.0 and states[-1].end_s == 22.0
    assert all(one.end_s == other.start_s for one, other in pairwise(states))

    def at(time_s: float) -> str:
        return next(each.label for each in states if each.start_s <= time_s < each.end_s)

    assert [at(t) for t in (1.0, 3.5, 5.0, 6.4, 9.1, 12.0, 15.5, 17.0, 21.0)] == [
        "listening", "thinking", "speaking", "thinking", "speaking", "listening", "thinking", "speaking", "idle",
    ]  # fmt: skip
    silent = states_of_turns(Annotation(), 5.0)
    assert [(each.start_s, each.end_s, each.label) for each in silent] == [(0.0, 5.0, "idle")]


def test_a_track_covers_what_it_lists_and_the_sounds_show_the_rest():
    turns = Annotation(speaking=(Span(0.0, 10.0),))
    states = resolve_states(StateTrack((Span(4.0, 6.0, "thinking"),)), turns, 12.0)
    assert [(each.start_s, each.end_s, each.label) for each in states] == [
        (0.0, 4.0, "speaking"), (4.0, 6.0, "thinking"), (6.0, 10.0, "speaking"), (10.0, 12.0, "idle"),
    ]  # fmt: skip
    heard = with_states(turns, (Span(0.0, 4.0, "listening"), Span(4.0, 12.0, "idle")))
    assert heard.listening == heard.partner == (Span(0.0, 4.0),)
    with pytest.raises(InputError, match=r"before the end of the sound, 12.00 s, got 20 s"):
        resolve_states(StateTrack((Span(20.0, 24.0, "idle"),)), turns, 12.0)


def test_csv_and_json_are_the_same_track(tmp_path):
    (tmp_path / "a.csv").write_text("start_s,end_s,state\n0,2,speaking\n2,,thinking\n5,,idle\n")
    rows = [{"start_s": 0, "end_s": 2, "state": "speaking"}, {"start_s": 2, "state": "thinking"}]
    content = {"schema": "talkingeyes.states/1", "states": [*rows, {"start_s": 5, "state": "idle"}]}
    (tmp_path / "a.json").write_text(json.dumps(content))
    found = load_states(tmp_path / "a.csv")
    assert found == load_states(tmp_path / "a.json")
    assert [(each.start_s, each.end_s, each.label) for each in found.spans] == [
        (0.0, 2.0, "speaking"), (2.0, 5.0, "thinking"), (5.0, np.inf, "idle"),
    ]  # fmt: skip


BAD = {
    "columns.csv": ("start,end,state\n0,1,idle\n", "columns should be start_s, end_s, state, got start, end, state"),
    "empty.csv": ("start_s,end_s,state\n", "should hold at least one state"),
    "name.csv": ("start_s,end_s,state\n0,1,asleep\n", "state 1 should be one of speaking, listening"),
    "number.csv": ("start_s,end_s,state\nx,1,idle\n", "start_s of state 1 should be a finite number, got 'x'"),
    "infinite.csv": ("start_s,end_s,state\n0,inf,idle\n", "end_s of state 1 should be a finite number, got 'inf'"),
    "order.csv": ("start_s,end_s,state\n3,4,idle\n1,2,idle\n", "state 1 should start at 0 s or later"),
    "overlap.csv": ("start_s,end_s,state\n0,4,idle\n3,5,thinking\n", "got 0 to 4 s"),
    "negative.csv": ("start_s,end_s,state\n-1,4,idle\n", "got -1 to 4 s"),
    "short.csv": ("start_s,end_s,state\n1,1.1,idle\n", "last 0.25 s or longer"),
    "ragged.csv": ("start_s,end_s,state\n1,2\n", "state 1 should have 3 columns"),
    "schema.json": ('{"states": []}', "schema should be talkingeyes.states/1, got None"),
    "list.json": ("[]", "schema should be talkingeyes.states/1, got list"),
    "more.json": ('{"schema": "talkingeyes.states/1", "states": [], "x": 1}', "should hold schema and a list"),
    "row.json": ('{"schema": "talkingeyes.states/1", "states": [[0]]}', "state 1 should have start_s"),
    "true.json": (
        '{"schema": "talkingeyes.states/1", "states": [{"start_s": true, "state": "idle"}]}',
        "start_s of state 1 should be a finite number, got True",
    ),
    "kind.json": ('{"schema": "talkingeyes.states/1", "states": [{"start_s": 0, "state": ["idle"]}]}', "got ['idle']"),
    "broken.json": ("{", "broken.json"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_tracks_are_refused_in_one_line_with_status_2(name, tmp_path, capsys):
    text, words = BAD[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as raised:
        load_states(tmp_path / name)
    assert words in str(raised.value) and "\n" not in str(raised.value)
    assert (
        call("animate", "speech.wav", "-o", str(tmp_path / "out"), "--states", str(tmp_path / name)) == 2
        and capsys.readouterr().err.count("\n") == 1
    )
    assert not (tmp_path / "out").exists()


def test_states_need_the_sound_and_a_dialogue_takes_no_track(tmp_path, capsys):
    with pytest.raises(InputError, match="states: should come with the sound"):
        PERFORMER.generate_from_embedding(np.zeros((100, 1), np.float32), 1, 0, FPS, Controls(states="auto"))
    with pytest.raises(InputError, match="states: should be auto or a track, got asleep"):
        Controls(states="asleep")
    (tmp_path / "a.csv").write_text("start_s,end_s,state\n0,,idle\n")
    options = ["--dialogue", "--states", str(tmp_path / "a.csv"), "-o", str(tmp_path / "out")]
    assert (
        call("animate", "a.wav", "b.wav", *options) == 2 and "should be auto in a dialogue" in capsys.readouterr().err
    )


def test_without_states_nothing_changes_and_eye_contact_takes_precedence():
    one = PERFORMER.perform(SOUND, 1, 0, FPS, Controls())[0]
    idle = StateTrack((Span(0.0, 30.0, "idle"),))
    fixed = perform_toy(states=idle, eye_contact=1.0)[0]
    head, space = fixed.motion.head, rotation.gaze_in_space(fixed.motion.head, fixed.motion.gaze)
    assert eye_contact_fraction(head, space, np.tile([0.0, 0.0, 1.0, 1.0], (len(head), 1))) > 0.95
    assert one.reasons and {each.state for each in one.reasons} == {"idle"}  # a silent sound
    assert replace(one, reasons=()).motion is one.motion


def test_example_of_the_docs_is_valid(request, tmp_path):
    text = Path(request.config.rootpath, "docs/control.md").read_text()
    start = text.index("start_s,end_s,state")
    (tmp_path / "a.csv").write_text(text[start : text.index("```", start)])
    assert {each.label for each in load_states(tmp_path / "a.csv").spans} == set(STATES)
