"""Information of speech about aversion: found where speech times gaze, absent where it does not."""

from __future__ import annotations

import numpy as np

from benchmarks.aversion_information import Aversion, aversion, aversion_information
from talkingeyes.audio.annotation import Annotation, Span

FPS, FRAMES = 25.0, 250


def annotation(random: np.random.Generator) -> Annotation:
    """Two utterances with a pause at a random place."""
    pause = random.uniform(3.0, 7.0)
    return Annotation(speaking=(Span(0.0, pause), Span(pause + 1.0, 10.0)))


def motions(follows_speech: bool) -> list[Aversion]:
    """Gaze of 40 speakers with 10 sounds each, averted for a second at the onset of its sound or of another."""
    random, found = np.random.default_rng(0), []
    for index in range(400):
        own, other = annotation(random), annotation(random)
        onset = (own if follows_speech else other).speaking[1].start_s
        times_s = np.arange(FRAMES) / FPS
        averted = np.abs(times_s - onset - random.normal(0, 0.2)) < 0.5
        found.append(aversion(f"s{index % 40}", FPS, averted, own))
    return found


def test_gaze_that_follows_speech_has_information_and_other_gaze_none():
    own, other = aversion_information(motions(True)), aversion_information(motions(False))
    assert own.low > 0.1
    assert own.low < own.value < own.high
    assert -0.02 < other.value < 0.02


def test_bins_hold_changes_and_events():
    averted = np.zeros(FRAMES, bool)
    averted[50:100] = True
    one = aversion("ann", FPS, averted, Annotation(speaking=(Span(0.0, 3.0), Span(4.0, 10.0))))
    assert np.flatnonzero(one.changes).tolist() == [24, 49], "the bins before frames 50 and 100"
    assert one.averted.sum() == 25
    assert one.seconds == 10.0
    assert one.age.sum(axis=1).tolist() == [1.0] * len(one.age)
    assert one.speech[:, :16].any(axis=1).sum() == 50, "two seconds before and after the onset at 4 s"
