"""Information of speech about aversion: found where speech times gaze, absent where it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.report.information import (
    SoundAversion,
    aversion_information,
    aversion_prediction,
    changes_per_s,
    shift_in_time,
    speech_events,
)

BINS, BIN_S = 125, 0.08
BOOTSTRAP = BootstrapSettings(n_resamples=200, confidence_level=0.95, seed=0)
TIMES_S = (np.arange(BINS) + 0.5) * BIN_S


def annotation(random: np.random.Generator) -> Annotation:
    """Two utterances with a pause at a random place."""
    pause = random.uniform(3.0, 7.0)
    return Annotation(speaking=(Span(0.0, pause), Span(pause + 1.0, 10.0)))


def motions(follows_speech: bool, samples: int = 1, seed: int = 0) -> list[SoundAversion]:
    """Gaze of 40 speakers with 10 sounds each, averted for a second at the onset of its sound or of another."""
    random, found = np.random.default_rng(seed), []
    for index in range(400):
        own, other = annotation(random), annotation(random)
        onset_s = (own if follows_speech else other).speaking[1].start_s
        averted = np.abs(TIMES_S - onset_s - random.normal(0, 0.2, (samples, 1))) < 0.5
        speech = speech_events(own, TIMES_S, 10.0)
        found.append(SoundAversion(f"s{index % 40}", averted, speech, samples * 10.0))
    return found


def test_gaze_that_follows_speech_has_information_and_other_gaze_none():
    own, other = (aversion_information(motions(follows), BOOTSTRAP) for follows in (True, False))
    assert own.low > 0.1
    assert own.low < own.value < own.high
    assert -0.02 < other.value < 0.02


@pytest.mark.long
def test_several_motions_of_a_sound_and_further_ones_give_the_same_with_less_overfitting():
    several = aversion_information(motions(True, samples=3), BOOTSTRAP)
    few = motions(True, seed=1)[:80]
    alone, further = aversion_information(few, BOOTSTRAP), aversion_information(few, BOOTSTRAP, motions(True))
    assert alone.value < further.value
    assert abs(further.value / several.value - 1) < 0.25


def test_events_to_come_are_left_out_for_a_live_model():
    early = [replace(each, averted=np.roll(each.averted, -20, axis=1)) for each in motions(True)]  # 1.6 s before
    whole, live = (aversion_information(early, BOOTSTRAP, lookahead_s=bound_s) for bound_s in (np.inf, 0.25))
    assert whole.low > 0.1
    assert live.high < whole.value / 2


def test_a_rule_that_locks_gaze_to_onsets_has_more_information_than_people_but_predicts_no_more_of_them():
    """People avert at the pause or elsewhere, by turns that a model may know; the rule averts at every pause."""
    random, people, knowing, rule, blind = np.random.default_rng(0), [], [], [], []
    for index in range(400):
        own, other = annotation(random), annotation(random)
        onsets_s = [each.speaking[1].start_s for each in (own, other)]
        onset_s = onsets_s[int(random.uniform() < 0.5)]
        speech = speech_events(own, TIMES_S, 10.0)
        for row, at_s, samples in (
            (people, onset_s, 1),
            (knowing, onset_s, 10),
            (rule, onsets_s[0], 10),
            (blind, 5.0, 10),
        ):
            averted = np.abs(TIMES_S - at_s - random.normal(0, 0.2, (samples, 1))) < 0.5
            row.append(SoundAversion(f"s{index % 40}", averted, speech, samples * 10.0))
    one_each = [replace(each, averted=each.averted[:1], seconds=10.0) for each in rule]
    assert aversion_information(one_each, BOOTSTRAP).value > 2 * aversion_information(people, BOOTSTRAP).value > 0
    assert abs(aversion_information(shift_in_time(one_each, 0), BOOTSTRAP).value) < 0.03
    predicted = [aversion_prediction(row, people, BOOTSTRAP) for row in (knowing, rule, blind)]
    assert predicted[0].low > predicted[1].high > predicted[1].low > 0.05
    assert predicted[2].value < predicted[1].low / 2, "the middle of the clip is where most are averted"
    assert abs(aversion_prediction(shift_in_time(rule, 0), people, BOOTSTRAP).value) < 0.01


def test_still_gaze_has_none():
    still = [replace(each, averted=np.zeros_like(each.averted)) for each in motions(True)]
    assert aversion_information(still, BOOTSTRAP).value == 0
    assert changes_per_s(still) == 0
    assert abs(aversion_prediction(still, motions(True), BOOTSTRAP).value) < 0.01


def test_bins_hold_changes_and_events():
    averted = np.zeros((1, BINS), bool)
    averted[:, 25:50] = True
    speech = speech_events(Annotation(speaking=(Span(0.0, 3.0), Span(4.0, 10.0))), TIMES_S, 10.0)
    one = SoundAversion("ann", averted, speech, 10.0)
    assert np.flatnonzero(one.changes[0]).tolist() == [24, 49], "the bins before the changes"
    assert changes_per_s([one]) == 0.2
    assert one.age.sum(axis=2).tolist() == [[1.0] * (BINS - 1)]
    assert one.age[0, [25, 49], 0].tolist() == [1, 0], "a change, and 24 bins after it"
    assert speech[:, :16].any(axis=1).sum() == 50, "two seconds before and after the onset at 4 s"
