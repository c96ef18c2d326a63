"""Dialogues: turns are detected in the sounds; the listener looks at the speaker, nods, and blinks at phrase ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from toy_performer import PERFORMER

from talkingeyes.animation.animation import Animation
from talkingeyes.animation.controls import Controls, Liveliness
from talkingeyes.animation.dialogue import animate_dialogue
from talkingeyes.animation.listening_behaviour import sample_listening_behaviour
from talkingeyes.animation.steps.eye_contact import eye_contact_fraction
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.turn_taking import detect_turns
from talkingeyes.audio.waveform import read_dialogue
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError

RATE = 16_000
TALK = ((0.0, 6.0, 0), (6.4, 12.0, 1), (12.5, 18.0, 0), (18.3, 26.0, 1), (26.5, 30.0, 0))


def talk() -> tuple[np.ndarray, np.ndarray]:
    """Alternating noise, in phrases of 1.6 s and gaps of 0.4 s."""
    rng = np.random.default_rng(0)
    sounds = np.zeros((2, 30 * RATE), np.float32)
    for start, end, who in TALK:
        sounds[who, int(start * RATE) : int(end * RATE)] = rng.normal(0, 0.1, int(end * RATE) - int(start * RATE))
    gap = (np.arange(30 * RATE) / RATE) % 2.0 > 1.6
    sounds[:, gap] = 0.0
    return sounds[0], sounds[1]


def test_turns_are_detected() -> None:
    heard = detect_turns(*talk())
    assert len(heard.partner) == 7
    for (start, end, _), span in zip([each for each in TALK if each[2] == 1], heard.listening, strict=True):
        assert abs(span.start_s - start) < 0.5
        assert abs(span.end_s - end) < 0.9
    assert detect_turns(*(sound * 0 for sound in talk())).partner == ()
    assert detect_turns(talk()[0], np.zeros(0, np.float32)).listening == ()


def looks(made: Animation, who: int) -> float:
    """Partner gaze during the other's turn."""
    times = np.arange(len(made.motion)) / 25
    listens = np.any([(times >= start + 0.3) & (times < end) for start, end, each in TALK if each != who], axis=0)
    head, space = made.motion.head, rotation.gaze_in_space(made.motion.head, made.motion.gaze)
    ahead = np.tile([0.0, 0.0, 1.0, 1.0], (len(times), 1))
    return eye_contact_fraction(head[listens], space[listens], ahead[listens])


def test_listeners_look_at_the_speaker_and_nod() -> None:
    sounds = talk()
    pairs = animate_dialogue(PERFORMER, sounds, 8, 0, 25.0)
    alone = PERFORMER.perform(sounds[0], 8, 0, 25.0)
    listening_ = [looks(pair.first, 0) for pair in pairs]
    assert np.mean(listening_) > 0.6
    assert np.mean(listening_) > np.mean([looks(each, 0) for each in alone]) + 0.15
    assert np.mean([looks(pair.second, 1) for pair in pairs]) > 0.6
    nodded = [np.abs(pair.first.motion.head - each.motion.head).max() for pair, each in zip(pairs, alone, strict=True)]
    assert np.median(nodded) > np.radians(1.0)


@pytest.mark.long
def test_listeners_blink_at_the_ends_of_phrases() -> None:
    """Gaze is calm here, since most blinks would otherwise be evoked by gaze shifts above 5 degrees."""
    sounds, calm = talk(), Controls(liveliness=Liveliness(gaze=0.1))
    pairs = animate_dialogue(PERFORMER, sounds, 24, 0, 25.0, (calm, calm))
    alone = PERFORMER.perform(sounds[0], 24, 0, 25.0, calm)
    ends = [span.end_s for span in detect_turns(*sounds).partner]
    near = [_near_ends(pair.first, ends) for pair in pairs]
    assert np.mean(near) > 1.15 * np.mean([_near_ends(each, ends) for each in alone])


def _near_ends(made: Animation, ends: list[float]) -> int:
    return sum(any(0.2 <= blink.onset_s - end <= 0.6 for end in ends) for blink in made.events.blinks)


def test_nods_answer_the_partners_phrases() -> None:
    sounds = talk()
    turns = detect_turns(*sounds)
    heard = [sample_listening_behaviour(turns, [0, index]) for index in range(20)]
    nods = [nod for each in heard for nod in each.nods]
    ends = np.array([span.end_s for span in turns.partner])
    assert len(nods) > 40
    assert all(0.0 < (nod.onset_s - ends[ends < nod.onset_s]).min() < 6.0 for nod in nods)


def test_habits_of_a_listener_hold_over_conversations() -> None:
    turns = Annotation(listening=(Span(0.0, 200.0),))

    def away(person: int, seed: int) -> float:
        looks = sample_listening_behaviour(turns, [seed], person=[person]).looks
        return sum(look.end_s - look.start_s for look in looks if look.averted)

    shares = np.array([[away(person, seed) for seed in range(4)] for person in range(30)])
    assert np.corrcoef(shares[:, 0], shares[:, 1])[0, 1] > 0.6
    assert shares.std(axis=1).mean() < 0.6 * shares.mean(axis=1).std()


@pytest.mark.parametrize(("population", "away"), [("face_to_face", (0.15, 0.33)), ("remote_call", (0.02, 0.22))])
def test_listeners_look_away_as_a_population_does(population: str, away: tuple[float, float]) -> None:
    """Recorded people: 0.19 to 0.28 face to face, 0.04 to 0.09 in calls (of few people, who differ much)."""
    turns = Annotation(listening=(Span(0.0, 60.0), Span(70.0, 80.0)))
    heard = [sample_listening_behaviour(turns, [0, index], population).looks for index in range(60)]
    shares = [sum(look.end_s - look.start_s for look in looks if look.averted) / 70.0 for looks in heard]
    assert away[0] < np.mean(shares) < away[1]
    assert all(look.end_s <= 60.0 or look.start_s >= 70.0 for looks in heard for look in looks)
    with pytest.raises(InputError, match=r"population: should be one of face_to_face, remote_call, got telephone"):
        sample_listening_behaviour(turns, [0], "telephone")


def test_the_same_dialogue_again_and_in_a_batch() -> None:
    one, many = animate_dialogue(PERFORMER, talk(), 1, 3, 25.0)[0], animate_dialogue(PERFORMER, talk(), 2, 3, 25.0)
    np.testing.assert_array_equal(one.second.motion.gaze, many[0].second.motion.gaze)
    assert one.first.events == many[0].first.events
    assert one.first.events.blinks != one.second.events.blinks


def test_two_channels_are_two_people(tmp_path: Path) -> None:
    sounds = talk()
    soundfile.write(tmp_path / "both.wav", np.stack(sounds, axis=1), RATE)
    for read, true in zip(read_dialogue(tmp_path / "both.wav"), sounds, strict=True):
        np.testing.assert_allclose(read, true, atol=1e-4)
    soundfile.write(tmp_path / "one.wav", sounds[0], RATE)
    with pytest.raises(InputError, match="two channels, a person each, got 1"):
        read_dialogue(tmp_path / "one.wav")


def test_the_shorter_sound_is_silent_in_the_end() -> None:
    one, other = talk()
    pair = animate_dialogue(PERFORMER, (one, other[: 10 * RATE]), 1, 0, 25.0)[0]
    assert len(pair.first.motion) == len(pair.second.motion) == 750
