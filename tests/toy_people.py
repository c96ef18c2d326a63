"""People for tests of the benchmark: main sequence saccades, a swaying head, counter-rotating eyes, blinks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.motion import Blink
from talkingeyes.core.rotation import eye_in_head
from talkingeyes.evaluation.benchmark.behaviour import Behaviour, behaviour
from talkingeyes.physiology import blinks, saccades

ANNOTATION = Annotation(speaking=(Span(2.0, 5.0), Span(6.0, 9.0)))


@dataclass(frozen=True)
class ToyPerson:
    """Behaviour of a person at any frame rate; `side` is the side of gaze aversions (1: left)."""

    seed: int
    side: float = 1.0
    seconds: float = 12.0

    def at(self, fps: float = 25.0, reference: Behaviour | None = None) -> Behaviour:
        """Frames at a rate."""
        rng = np.random.default_rng(self.seed)
        times = np.arange(round(self.seconds * fps)) / fps
        chain, gaze = [], np.zeros(2)
        onset = rng.uniform(0.2, 0.8)
        while onset < self.seconds - 0.5:
            away = rng.random() < 0.4
            target = np.radians([self.side * rng.uniform(8, 16), rng.uniform(-4, 4)] if away else rng.normal(0, 1, 2))
            chain.append(saccades.sample_saccade(onset, gaze, target, rng))
            gaze, onset = np.array(chain[-1].end_rad), onset + rng.uniform(0.4, 1.4)
        space = saccades.gaze_path(chain, (0.0, 0.0), times)
        phase = rng.uniform(0, 6, (3, 3))
        sway = sum(np.radians(3 / n) * np.sin(2 * np.pi * 0.35 * n * times[:, None] + phase[n - 1]) for n in (1, 2, 3))
        head = sway + np.radians([0.0, 0.0, 4 * self.side])
        gaze_in_head = eye_in_head(head, np.repeat(space[:, None], 2, axis=1))
        closed = [Blink(at, 0.09, 0.03, 0.2, 1.0) for at in np.arange(rng.uniform(0.5, 2), self.seconds - 1, 2.5)]
        lid = np.repeat(blinks.blink_closure(closed, times)[:, None], 2, axis=1)
        return behaviour(fps, {"head": head, "gaze": gaze_in_head, "lid": lid}, None, ANNOTATION, reference)


def people(count: int, seed: int = 0) -> list[ToyPerson]:
    """People with aversions to the left and people with aversions to the right."""
    return [ToyPerson(seed * 1000 + index, 1.0 if index % 2 else -1.0) for index in range(count)]
