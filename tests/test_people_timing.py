"""Timing of gaze beside recorded conversations: tables, turns, measures in closed form, and the command."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import soundfile

from talkingeyes.audio.annotation import Span
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.people.aversion_likelihood import likelihood_gains
from talkingeyes.evaluation.people.conversations import (
    AGREED,
    NEITHERS,
    OWN,
    PARTNERS,
    RATE_HZ,
    ConversationGaze,
    Turns,
    read_conversations,
)
from talkingeyes.evaluation.people.timing import LAGS_S, MEASURES, compare_timing, timing_row, turn_information
from talkingeyes.synthesis.speech_synthesis import DialogueVoices, synthesize_turns
from talkingeyes.synthesis.voice_profiles import sample_voice
from talkingeyes.workflows.evaluate_timing import evaluate_timing, row_name

SETTINGS = BootstrapSettings(n_resamples=200, confidence_level=0.95, seed=0)
SECONDS = 600
CONTACT = """pair,person,coder,start_ms,end_ms
p,a,1,0,2000
p,a,1,3000,8000
p,b,1,0,9000
p,a,2,0,2600
p,b,2,1000,9000
"""
TURNS = """pair,start_s,end_s,speaker
p,0,4,a
p,4,4,b
p,4,5,a
p,5,9,b
"""


def turns(seed: int) -> Turns:
    """Turns of a random length from 3 to 17 s that alternate."""
    edges = np.cumsum(np.random.default_rng(seed).integers(3, 18, SECONDS // 3)).astype(float)
    spans = [Span(*each) for each in pairwise([0.0, *edges[edges < SECONDS - 3], SECONDS])]
    return Turns.of(spans[::2], spans[1::2])


def conversation(pair: int, follows: bool, own: float = 0.4, partners: float = 0.2) -> ConversationGaze:
    """Gaze that is averted for the second around starts of own turns, else a state a second by who speaks, of its own
    turns or those of another pair."""
    of, frames = turns(pair if follows else pair + 1000), round(SECONDS * RATE_HZ)
    rng = np.random.default_rng([pair, 5])
    second = np.repeat(rng.random(SECONDS), round(RATE_HZ))
    averted = second < np.where(of.role(frames) == OWN, own, partners)
    for start_s in of.changes(2.0)[0]:
        averted[round((start_s - 0.5) * RATE_HZ) : round((start_s + 1) * RATE_HZ)] = True
    return ConversationGaze(f"p{pair}", averted, np.ones(frames, bool), turns(pair))


@pytest.fixture(scope="module")
def following() -> list[ConversationGaze]:
    return [conversation(pair, True) for pair in range(24)]


def test_turns_are_to_the_second_and_joined() -> None:
    found = Turns.of([Span(0.2, 3.4), Span(3.9, 6.2), Span(9.0, 9.3)], [Span(6.4, 12.6)])
    assert found == Turns((Span(0.0, 6.0),), (Span(6.0, 13.0),))
    assert found.swapped.role(350).tolist() == [PARTNERS] * 150 + [OWN] * 175 + [NEITHERS] * 25
    assert found.changes(2.0) == ([], [6.0]) and found.swapped.changes(2.0) == ([6.0], [])
    assert found.changes(6.5) == ([], [])


def test_tables_are_read_by_coder_and_where_they_agree(tmp_path: Path) -> None:
    (tmp_path / "contact.csv.gz").write_bytes(gzip.compress(CONTACT.encode()))
    (tmp_path / "turns.csv").write_text(TURNS)
    found = read_conversations(tmp_path / "contact.csv.gz", tmp_path / "turns.csv")
    assert list(found) == ["1", "2", AGREED]
    (a, b), (other, _), (agreed, _) = found.values()
    assert a.turns == Turns((Span(0.0, 5.0),), (Span(5.0, 9.0),)) == b.turns.swapped
    assert len(a.averted) == 9 * RATE_HZ and a.averted.sum() == 2 * RATE_HZ and not b.averted.any()
    assert other.averted.sum() == round(6.4 * RATE_HZ)
    assert agreed.known.sum() == (a.averted == other.averted).sum() == round(3.4 * RATE_HZ)


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        (
            "contact",
            ("p,b,1,0,9000", "p,b,1,0,soon"),
            r"contact.csv, row 4: end_ms should be a time of at least 0, within a day, got s",
        ),
        ("contact", ("p,b,1,0,9000", "p,b,1,99,9"), r"contact.csv, row 4: should end at or after its start 0.099 s"),
        ("contact", ("p,b,1,0,9000", "p,c,1,0,9000"), "contact.csv, row 4: person should be a or b, got c"),
        ("contact", ("p,b,1,0,9000", "q,b,1,0,9000"), "contact.csv, row 4: pair q has no turns in .*turns.csv"),
        (
            "contact",
            (CONTACT, CONTACT.splitlines()[0] + "\np,a,1,0,20\n"),
            "contact.csv, row 2: looks and turns of pair p should last 40 ms or more",
        ),
        ("contact", ("coder", "rater"), "contact.csv: should have a column coder, got pair, person, rater"),
        ("turns", ("4,5,a", "4,2,a"), "turns.csv, row 4: should end at or after its start 4 s, got 2 s"),
        (
            "turns",
            ("4,5,a", "-4,5,a"),
            "turns.csv, row 4: start_s should be a time of at least 0, within a day",
        ),
        ("turns", ("4,5,a", "4,5,x"), "turns.csv, row 4: speaker should be a or b, got x"),
    ],
)
def test_a_wrong_row_is_one_line(tmp_path: Path, table: str, change: tuple[str, str], message: str) -> None:
    for name, text in (("contact", CONTACT), ("turns", TURNS)):
        (tmp_path / f"{name}.csv").write_text(text.replace(*change) if name == table else text)
    with pytest.raises(InputError, match=message):
        read_conversations(tmp_path / "contact.csv", tmp_path / "turns.csv")


def test_known_shares_and_rise_are_found(following: list[ConversationGaze]) -> None:
    row = timing_row(following, SETTINGS)
    found = row["measures"]
    # At a start gaze is always averted; 2 s before, it is as in the rest of the partner's turn.
    assert found["start_rise"]["low"] < 0.8 < found["start_rise"]["high"]
    curve = np.array(row["curves"]["start"])
    assert (curve[np.abs(LAGS_S - 0.2) < 0.5] == 1).all() and curve[LAGS_S < -1.2].mean() == pytest.approx(
        0.2, abs=0.03
    )
    assert found["end_fall"]["value"] == pytest.approx(0.2, abs=0.06)
    assert found["own"]["value"] == pytest.approx(0.4 + 0.6 * 1.0 / 10, abs=0.02)
    assert found["partners"]["value"] == pytest.approx(0.2 + 0.8 * 0.5 / 10, abs=0.02)
    assert "neithers" not in found and row["units"] == 24


def test_rates_and_durations_of_a_regular_gaze() -> None:
    """Three seconds at the partner, one away: 15 looks away a minute, whatever the cut at the end."""
    averted = np.tile(np.repeat([False, True], [75, 25]), 150)
    found = timing_row([ConversationGaze("p", averted, np.ones(len(averted), bool), turns(0))], SETTINGS)["measures"]
    assert found["looks_away"]["value"] == pytest.approx(15)
    assert (found["look"]["value"], found["aversion"]["value"]) == (3.0, 1.0)


def test_information_is_that_of_the_shares(following: list[ConversationGaze]) -> None:
    """Without the start of turns, information is the mutual information of who speaks and a state: in closed form."""
    people = [
        ConversationGaze(each.unit, averted, each.known, each.turns)
        for pair, each in enumerate(following)
        for averted in [
            np.random.default_rng(pair).random(len(each.averted))
            < np.where(each.turns.role(len(each.averted)) == OWN, 0.45, 0.25)
        ]
    ]
    roles = np.concatenate([each.turns.role(len(each.averted)) for each in people])
    share = np.array([0.45, 0.25])
    within = (roles == OWN).mean() * share[0] + (roles != OWN).mean() * share[1]

    def entropy(p: np.ndarray) -> np.ndarray:
        return -p * np.log(p) - (1 - p) * np.log(1 - p)

    expected = entropy(within) - (roles == OWN).mean() * entropy(share[0]) - (roles != OWN).mean() * entropy(share[1])
    found = turn_information(people, SETTINGS)
    assert found.low < expected < found.high
    assert found.value == pytest.approx(expected, rel=0.1)


def test_gaze_that_ignores_turns_has_no_information_and_no_rise(following: list[ConversationGaze]) -> None:
    random = timing_row([conversation(pair, False) for pair in range(24)], SETTINGS)["measures"]
    assert turn_information(following, SETTINGS).low > 0.02
    assert random["information"]["low"] < 0 < random["information"]["high"] < 0.01
    assert random["start_rise"]["low"] < 0 < random["start_rise"]["high"]


def test_unknown_frames_do_not_count(following: list[ConversationGaze]) -> None:
    half = np.arange(len(following[0].averted)) < 7500
    cut = [ConversationGaze(e.unit, e.averted[:7500], e.known[:7500], e.turns) for e in following]
    hidden = [ConversationGaze(e.unit, e.averted ^ ~half, e.known & half, e.turns) for e in following]
    one, other = (timing_row(each, SETTINGS)["measures"] for each in (cut, hidden))
    assert one["own"] == other["own"] and one["partners"] == other["partners"]


def recorded(folder: Path) -> list[str]:
    """Tables of six made pairs, as options of the command."""
    looks, spoken = ["pair,person,coder,start_ms,end_ms"], ["pair,start_s,end_s,speaker"]
    for pair in range(6):
        gaze = conversation(pair, True)
        change = np.flatnonzero(np.diff(gaze.averted.astype(int), prepend=1, append=1)) * 1000 / RATE_HZ
        looks += [
            f"p{pair},{who},1,{a:.0f},{b:.0f}" for who in "ab" for a, b in zip(change[::2], change[1::2], strict=True)
        ]
        every = sorted(
            [(s, "a") for s in gaze.turns.own] + [(s, "b") for s in gaze.turns.partner], key=lambda e: e[0].start_s
        )
        spoken += [f"p{pair},{span.start_s},{span.end_s},{who}" for span, who in every]
    (folder / "contact.csv").write_text("\n".join(looks))
    (folder / "turns.csv").write_text("\n".join(spoken))
    return ["--people", str(folder / "contact.csv"), "--turns", str(folder / "turns.csv")]


@pytest.mark.long
def test_command_compares_sounds_of_two_channels(tmp_path: Path) -> None:
    options = recorded(tmp_path)
    rng, rate = np.random.default_rng(0), 16000
    (tmp_path / "motions").mkdir()
    for index in range(8):
        taken = turns(index).role(3000)[::25]
        own, since = (
            taken == OWN,
            np.arange(120) - np.maximum.accumulate(np.arange(120) * (np.diff(taken, prepend=-1) != 0)),
        )
        sound = rng.normal(0, 0.1, (120 * rate, 2)) * np.repeat(np.stack([own, ~own], axis=1), rate, axis=0)
        soundfile.write(tmp_path / f"s{index}a.wav", sound + rng.normal(0, 1e-5, sound.shape), rate)
        gaze = np.zeros((3000, 2, 3))
        gaze[:, :, 1] = np.repeat((own & (since < 3))[:, None], 25, axis=0) * 0.3
        Motion.of(25.0, np.zeros((3000, 3)), gaze).save(tmp_path / "motions" / f"s{index}a.npz")
    code = "import sys; from talkingeyes.cli.main import main; main(); sys.exit('torch' in sys.modules)"
    command = [sys.executable, "-c", code, "evaluate", str(tmp_path / "motions"), *options, "--sound", str(tmp_path)]
    done = subprocess.run(
        [*command, "--n-resamples", "20", "-o", str(tmp_path / "out")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "out" / "timing.json").read_text())["rows"]
    assert list(rows) == ["people, coder 1", "motions"]
    found = rows["motions"]["measures"]
    assert found["own"]["value"] > 0.2 and found["partners"]["value"] < 0.1
    assert found["start_rise"]["value"] > 0.6 and found["information"]["low"] > 0.1
    assert all(each.title in done.stdout for each in MEASURES)
    soundfile.write(tmp_path / "s0a.wav", np.zeros(rate), rate)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "two channels" in done.stderr


def test_mistakes_are_one_line(tmp_path: Path) -> None:
    people, contact, flag, table = recorded(tmp_path)
    assert (people, flag) == ("--people", "--turns")
    with pytest.raises(InputError, match="needs the sounds of the motions"):
        evaluate_timing(tmp_path, contact, table)
    with pytest.raises(InputError, match="should have a column person"):
        evaluate_timing(tmp_path, table, table, sound=tmp_path)


def test_a_row_without_people_is_left_out(following: list[ConversationGaze]) -> None:
    content = compare_timing({"truth": [], "people": following[:2]}, SETTINGS)
    assert list(content["rows"]) == ["people"]


def modelled(follows: float, pair: int) -> tuple[ConversationGaze, np.ndarray]:
    """Gaze whose probability of aversion alternates between 0.2 and 0.6 by turns, and the share of a model's samples
    that knows a part of it."""
    own = turns(pair)
    frames = round(SECONDS * RATE_HZ)
    rng = np.random.default_rng([pair, 7])
    chance = np.where(own.role(frames) == OWN, 0.6, 0.2)
    averted = rng.random(frames) < chance
    share = follows * chance + (1 - follows) * np.where(turns(pair + 500).role(frames) == OWN, 0.6, 0.2)
    return ConversationGaze(f"p{pair}", averted, np.ones(frames, bool), own), rng.binomial(16, share) / 16


def test_likelihood_of_a_model_that_knows_is_the_information_and_of_one_that_does_not_0() -> None:
    gains = {}
    for follows in (1.0, 0.0):
        people, shares = zip(*(modelled(follows, pair) for pair in range(8)), strict=True)
        gains[follows] = likelihood_gains(people, shares, 16, SETTINGS)
    half = np.array([0.6, 0.2])
    entropy = -half * np.log(half) - (1 - half) * np.log(1 - half)
    known = -0.4 * np.log(0.4) - 0.6 * np.log(0.6) - entropy.mean()  # own and partner's turns are as long
    assert 0.6 * known < gains[1.0]["shifted"].value < known * 1.1  # smoothing blurs the changes
    assert gains[1.0]["constant"].value == pytest.approx(gains[1.0]["shifted"].value, abs=0.01)
    assert gains[0.0]["shifted"].low < 0 < gains[0.0]["shifted"].high
    assert abs(gains[0.0]["shifted"].value) < 0.01


def test_speech_fills_the_given_turns_alone() -> None:
    rng = np.random.default_rng(0)
    voices = DialogueVoices(sample_voice(rng, "en"), sample_voice(rng, "en"))
    spoken = synthesize_turns(voices, ([Span(1.0, 4.0), Span(6.0, 9.5)], [Span(4.0, 6.0)]), 9.0, rng)
    assert len(spoken.sound) == len(spoken.partner) == 9 * 16000
    loud = {
        name: np.abs(sound.reshape(-1, 1600)).max(axis=1) > 1e-3
        for name, sound in (("own", spoken.sound), ("partner", spoken.partner))
    }
    times_s = np.arange(90) / 10
    own = ((times_s >= 1) & (times_s < 4)) | (times_s >= 6)
    assert not loud["own"][~own].any() and loud["own"][own].mean() > 0.6
    assert loud["partner"][(times_s >= 4) & (times_s < 6)].mean() > 0.6 and loud["partner"].sum() <= 20
    said = spoken.annotation
    assert said.listening == (Span(4.0, 6.0),) and said.speaking[0].start_s == pytest.approx(1.0)
    assert all(any(a <= word.start_s and word.end_s <= b + 1e-9 for a, b in ((1, 4), (6, 9))) for word in said.words)
    assert len(said.words) > 8


def test_real_people_look_away_in_their_own_turns(request: pytest.FixtureRequest) -> None:
    folder = request.config.rootpath.parent / "shared/data/real/gaze"
    if not (folder / "face_to_face_contact.csv.gz").is_file():
        pytest.skip("no real recordings here")
    found = read_conversations(folder / "face_to_face_contact.csv.gz", folder / "face_to_face_turns.csv.gz")
    assert list(found) == ["1", "2", AGREED] and all(len(people) == 48 for people in found.values())
    rows = {name: timing_row(people, SETTINGS)["measures"] for name, people in found.items()}
    committed = json.loads((request.config.rootpath / "docs/results/people_timing.json").read_text())["rows"]
    for name, row in rows.items():
        assert row["own"]["value"] > row["partners"]["value"] + 0.05
        figures = committed[row_name(name)]["measures"]
        assert {key: each["value"] for key, each in row.items()} == pytest.approx(
            {key: each["value"] for key, each in figures.items()}, rel=1e-6
        )
    for name in ("2", AGREED):  # the first coder's is not above 0
        assert rows[name]["start_rise"]["low"] > 0.05 and rows[name]["end_fall"]["low"] > 0.03
