"""People for tests: main sequence saccades, a swaying head, counter-rotating eyes, blinks; a table of people."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.motion import Blink
from talkingeyes.core.rotation import eye_in_head
from talkingeyes.corpus.gaze_datasets import CONVERSATION_CM, CONVERSATION_CM_PER_PX
from talkingeyes.evaluation.detectors.behaviour import Behaviour, behaviour
from talkingeyes.evaluation.people.tracker import TRACKER, GazeClip, detect_screen_fixations, track
from talkingeyes.physiology import blinks, saccades
from talkingeyes.physiology.gaze_population import STATES

HEADING = "participant,state,segment,start_sample,length_samples,duration_ms,center_x_px,center_y_px"
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


def chain_gaze(seconds, rng, fps=50.0, leaving=0.5, returning=1.5, spread=8.0):
    """Gaze of a Markov chain between the partner and places away from it; both rates per second."""
    gaze, at, away, place = np.zeros((round(seconds * fps), 2)), 0.0, False, np.zeros(2)
    while at < seconds:
        stay = rng.exponential(1 / (returning if away else leaving))
        gaze[round(at * fps) : round((at + stay) * fps) + 1] = place
        at, away = at + stay, not away
        angle = rng.uniform(0, 2 * np.pi)
        place = spread * rng.uniform(1, 2) * np.array([np.cos(angle), 0.5 * np.sin(angle)]) if away else np.zeros(2)
    return gaze


def people_csv(path, people=6):
    """A table of recorded people in the format of the data set."""
    lines = [HEADING]
    for index in range(people):
        rng = np.random.default_rng([index, 5])
        gaze = chain_gaze(120.0, rng, spread=6.0 + index)
        state = (np.arange(len(gaze)) >= len(gaze) / 2).astype(int)
        clip = GazeClip(50.0, gaze, state, np.zeros(len(gaze), bool))
        for name, label in zip(STATES, ("SPEAK", "LISTEN"), strict=True):
            found = detect_screen_fixations(track(clip, np.zeros(2), TRACKER, rng))[name]
            px = 1125 - np.tan(np.radians(found.centre_deg)) * CONVERSATION_CM / CONVERSATION_CM_PER_PX
            start, length = (np.rint(each * 90).astype(int) for each in (found.onset_s, found.duration_s))
            rows = zip(found.segment, start, length, px, strict=True)
            lines += [f"{index},{label},{g},{s},{n},{n * 11.103},{x:.2f},{y:.2f}" for g, s, n, (x, y) in rows]
    path.write_text("\n".join(lines))
    return path
