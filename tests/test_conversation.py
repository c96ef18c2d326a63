"""Conversation turns: partner gaze, nods and blinks of a listener, causes of aversions, emotions, partner distance."""

from dataclasses import replace

import numpy as np
import pytest

from talkingeyes.audio.annotation import EMOTIONS, Annotation, Phoneme, Span
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Events, HeadMovement, Saccade, VergenceMovement
from talkingeyes.physiology.blinks import PHYSIOLOGICAL, sample_blinks
from talkingeyes.synthesis import head_gestures
from talkingeyes.synthesis.emotion import EMOTION_FACTORS, emotional_style
from talkingeyes.synthesis.gaze_aversion import gaze_intervals, sample_gaze_cues
from talkingeyes.synthesis.gaze_shifts import DIRECTIONS, octant_probabilities
from talkingeyes.synthesis.speakers import sample_style, with_habits
from talkingeyes.synthesis.take import sample_take

TURN_S, TURNS = 8.0, 6
SECONDS = 2 * TURN_S * TURNS


def by_turns() -> Annotation:
    """Eight seconds of own speech and eight of the partner's, in phrases of two seconds."""
    phrases = [tuple(Span(at + 2.0 * k, at + 2.0 * k + 1.6) for k in range(4)) for at in TURN_S * np.arange(2 * TURNS)]
    own, others = (tuple(span for turn in phrases[first::2] for span in turn) for first in (0, 1))
    onsets = [span.start_s + 0.2 * k for span in own for k in range(8)]
    phonemes = tuple(Phoneme(t, t + 0.2, "at"[k % 2], k % 4 == 0, 0.8 * (k % 4 == 0)) for k, t in enumerate(onsets))
    listening = tuple(Span(turn[0].start_s, turn[-1].end_s) for turn in phrases[1::2])
    return Annotation(phonemes=phonemes, speaking=own, listening=listening, partner=others)


@pytest.fixture(scope="module")
def annotation():
    return by_turns()


@pytest.fixture(scope="module")
def styles():
    return [sample_style(np.random.default_rng(number)) for number in range(30)]


def share(states, spans):
    """Fraction of the time in the spans with gaze at the partner."""
    times = np.arange(0.0, SECONDS, 0.05)
    aversions = np.any([(times >= s.start_s) & (times < s.end_s) for s in states if s.averted], axis=0)
    inside = np.any([(times >= s.start_s) & (times < s.end_s) for s in spans], axis=0)
    return 1.0 - aversions[inside].mean()


def test_listeners_look_more_than_talkers(annotation, styles):
    states = [gaze_intervals(annotation, style, SECONDS, np.random.default_rng(k)) for k, style in enumerate(styles)]
    talking = [share(each, annotation.speaking) for each in states]
    listening = [share(each, annotation.listening) for each in states]
    assert 0.45 <= np.mean(talking) <= 0.70 and np.std(talking) >= 0.08
    assert 0.70 <= np.mean(listening) <= 0.95
    assert np.corrcoef(talking, [style.partner_gaze_speaking for style in styles])[0, 1] > 0.7


def test_quiet_eyes_look_away_less(annotation, styles):
    lively, quiet = (
        np.mean(
            [
                share(
                    gaze_intervals(annotation, replace(s, liveliness=live), SECONDS, np.random.default_rng(k)),
                    annotation.speaking,
                )
                for k, s in enumerate(styles)
            ]
        )
        for live in (1.0, 0.4)
    )
    assert quiet > lively + 0.1


def test_aversion_direction_depends_on_cause(annotation, styles):
    style = replace(styles[0], speech_coupling=1.0, partner_gaze_speaking=0.55)
    cues = [sample_gaze_cues(annotation, style, np.random.default_rng(seed)) for seed in range(20)]
    starts = [look for each in cues for look in each.aversions]
    turns = annotation.speaking[::4]
    planned = [look for look in starts if any(abs(look.start_s + 0.3 - turn.start_s) < 0.3 for turn in turns)]
    assert planned and np.mean([look.cause == "planning" for look in planned]) > 0.8
    assert {look.cause for look in starts} == {"planning", "floor"}
    for cause in DIRECTIONS:
        shares = octant_probabilities(cause)
        assert shares.sum() == pytest.approx(1.0) and shares[[0, 4]].sum() == pytest.approx(DIRECTIONS[cause][1])
    assert octant_probabilities("planning")[2] > octant_probabilities("intimacy")[2]


def test_cues_of_speech_can_be_delayed_and_weakened(annotation, styles):
    def cues(**changes):
        return [sample_gaze_cues(annotation, replace(style, **changes), np.random.default_rng(1)) for style in styles]

    for early, late in zip(cues(), cues(cue_delay_s=0.8), strict=True):
        for one, other in zip(early.aversions, late.aversions, strict=True):
            assert (other.start_s - one.start_s, other.end_s - one.end_s) == pytest.approx((0.8, 0.8))
        assert np.subtract(late.returns_s, early.returns_s) == pytest.approx(0.8)
    counts = [sum(len(each.aversions) for each in cues(speech_coupling=coupling)) for coupling in (1.0, 0.5, 0.0)]
    assert counts[0] > counts[1] > counts[2] == 0


def test_aversions_lead_the_turn(annotation, styles):
    """Many speakers begin with gaze averted, and look away shortly before."""
    before = []
    for seed, style in enumerate(styles):
        for look in gaze_intervals(annotation, style, SECONDS, np.random.default_rng(seed)):
            covered = [
                t.start_s for t in annotation.speaking[4::4] if look.averted and look.start_s <= t.start_s < look.end_s
            ]
            before += [look.start_s - start for start in covered]
    assert len(before) / (len(styles) * (TURNS - 1)) > 0.3
    low, middle, high = np.percentile(before, [25, 50, 75])
    assert -1.0 <= middle <= -0.2 and high - low >= 0.6


def test_listeners_nod_after_phrases_and_blink_after_them(annotation, styles):
    moves = [
        m
        for k, style in enumerate(styles)
        for m in head_gestures.listener_nods(annotation, style, np.random.default_rng(k))
    ]
    ends = np.array([span.end_s for span in annotation.partner])
    firsts = [m for m in moves if m.delta_rad[0] > 0]
    assert firsts and all((m.onset_s - ends[ends <= m.onset_s].max()) < 6.0 for m in firsts)
    assert sum(m.delta_rad[0] for m in moves) == pytest.approx(0.0, abs=1e-9)
    assert not head_gestures.listener_nods(Annotation(), styles[0], np.random.default_rng(0))
    # Recorded nods of feedback: median length 1.16 s, quartiles 0.76 and 1.92; 55 % have one cycle or less than one.
    nods = np.split(moves, [k for k in range(1, len(moves)) if moves[k].onset_s - _end_s(moves[k - 1]) > 1e-6])
    lengths = [_end_s(each[-1]) - each[0].onset_s for each in nods]
    np.testing.assert_allclose(np.quantile(lengths, [0.25, 0.5, 0.75]), [0.76, 1.16, 1.92], rtol=0.25)
    assert np.mean([len(each) == 2 for each in nods]) == pytest.approx(0.5, abs=0.08)
    onsets = [
        b.onset_s
        for k in range(40)
        for b in sample_blinks(PHYSIOLOGICAL, SECONDS, np.random.default_rng(k), annotation, 20.0)
    ]
    after = [t - end for t in onsets for end in ends if 0.0 <= t - end < 0.5]
    late = np.mean(np.array(after) >= 0.25)
    assert late > 0.6


def _end_s(move):
    return move.onset_s + move.duration_s


def test_the_head_is_calm_while_listening(annotation, styles):
    for style in styles[:3]:
        head = (
            sample_take(annotation, style, SECONDS, np.random.default_rng(0), PHYSIOLOGICAL)
            .motion(25.0, int(25 * SECONDS))
            .head
        )
        speed = np.degrees(np.linalg.norm(np.diff(head, axis=0), axis=1)) * 25
        times = np.arange(len(speed)) / 25
        listens = np.any([(times >= s.start_s) & (times < s.end_s) for s in annotation.listening], axis=0)
        assert speed[~listens].mean() > 1.3 * speed[listens].mean()


def test_emotions_change_style_by_intensity(styles):
    style = styles[0]
    assert set(EMOTION_FACTORS) == set(EMOTIONS)
    assert emotional_style(style, "neutral", 1.0) == style
    weak, strong = (emotional_style(style, "sad", amount) for amount in (0.3, 1.0))
    assert (
        strong.head_scale < weak.head_scale < style.head_scale
        and strong.partner_gaze_speaking < weak.partner_gaze_speaking < style.partner_gaze_speaking
    )
    assert strong.rest_pitch > weak.rest_pitch > style.rest_pitch
    assert emotional_style(style, "angry", 1.0).head_scale > style.head_scale
    for emotion in EMOTIONS:
        assert 0.0 < emotional_style(style, emotion, 1.2).partner_gaze_listening < 1.0


@pytest.mark.parametrize("population", ["face_to_face", "remote_call"])
def test_sadness_lowers_gaze_and_fear_moves_it(annotation, styles, population):
    """Pitch of averted gaze from the partner, and rate of saccades."""
    found = {}
    for emotion in ("neutral", "sad", "fear"):
        down_deg, per_s = [], []
        for number, style in enumerate(styles[:5]):
            one = (
                style if population == "face_to_face" else with_habits(style, population, np.random.default_rng(number))
            )
            felt = replace(annotation, emotion=emotion, intensity=0 if emotion == "neutral" else 3)
            take = sample_take(felt, one, SECONDS, np.random.default_rng(number), PHYSIOLOGICAL)
            shifts = take.events.saccades
            ends = np.array([[each.onset_s, *each.end_rad] for each in shifts])
            averted = np.any(
                [(ends[:, 0] >= s.start_s) & (ends[:, 0] < s.end_s) for s in take.gaze_intervals if s.averted], axis=0
            )
            down_deg.append(np.degrees(ends[averted, 2].mean()))
            per_s.append(len(shifts) / SECONDS)
        found[emotion] = np.mean(down_deg), np.mean(per_s)
    assert found["sad"][0] < found["neutral"][0] - 1.5
    assert found["sad"][1] < found["neutral"][1] < found["fear"][1]


def test_vergence_is_set_for_partner_and_farther_targets(annotation, styles):
    take = sample_take(annotation, styles[0], SECONDS, np.random.default_rng(3), PHYSIOLOGICAL)
    onsets = [each.onset_s for each in take.events.vergence_movements]
    assert onsets == sorted(onsets) and onsets[0] <= 0.0
    for each in take.events.vergence_movements:
        state = next(look for look in take.gaze_intervals[::-1] if look.start_s <= each.onset_s + 1e-9)
        assert 1.5 <= each.distance_m <= 4.0 if state.averted else 0.8 <= each.distance_m <= 1.3


def test_events_are_kept_complete(tmp_path):
    events = Events(
        (Saccade(0.1, 0.04, (0.0, 0.0), (0.1, 0.0), 0.45),),
        (HeadMovement(0.2, 0.3, (0.0, 0.1, 0.0)),),
        (Blink(0.5, 0.08, 0.02, 0.2, 1.0),),
        (VergenceMovement(0.1, 1.5),),
    )
    events.save(tmp_path / "a.json")
    assert Events.load(tmp_path / "a.json") == events
    (tmp_path / "b.json").write_text('{"schema": "talkingeyes.events/2", "blinks": []}')
    assert Events.load(tmp_path / "b.json") == Events()
    for text, says in (
        ("[]", "not a readable events file"),
        ("{}", "schema should be talkingeyes.events/2, got None"),
        ('{"schema": "talkingeyes.events/1", "blinks": []}', "schema should be talkingeyes.events/2, got talkingeyes"),
        ('{"schema": "talkingeyes.events/2", "blinks": [{"onset_s": 1}]}', "not a readable events file"),
    ):
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(InputError, match=says):
            Events.load(tmp_path / "c.json")
