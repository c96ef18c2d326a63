"""A simulated screen tracker, the detector of fixations of the recorded people, and gaze that looks at nothing.

Generated gaze passes both before it is compared with recorded people: it is sampled at 90 Hz, gets noise and loses
samples, and fixations are found in it as in the recordings. The detector is that of the data set (its script
move_data.html): I-DT (Salvucci & Goldberg 2000) on pixels of the screen; a fixation lasts at least 100 ms, and its
samples lie within 30 pixels (0.7 degrees) in x and in y. A lost sample ends a segment, and the last fixation of each
segment is left out, as in the recordings.

Source of the settings: rate, screen and detector from the data set. Noise and losses are estimated from the eight
people that are not kept for validation (medians of people). While they listen, 1.3 fixations a second are followed by
one nearer than 1.5 degrees, half of these by one nearer than 0.5 degrees: noise and small saccades. Under the noise
here, a still gaze that the tracker loses as often splits 0.8 times a second, into fixations 0.3 degrees apart. Segments
last 0.8 s while speaking and 1.2 s while listening (first onset to last end), which 1.43 and 0.91 losses per second
give. Blinks of the motion lose samples too; BLINKS_PER_S is taken off the random losses. Segments are 0.56 s apart, of
which about 0.3 s are the fixation that is left out.

Gaze that looks at nothing is a baseline that a measure must fail to be worth anything: the eyes jump to a direction
drawn uniformly every 0.2 to 5 s and rest there; the head is still, and sound is not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.signal import lfilter

from talkingeyes.corpus.gaze_datasets import CONVERSATION_CM, CONVERSATION_CM_PER_PX, CONVERSATION_RATE_HZ
from talkingeyes.evaluation.detectors.fixations import low_dispersion_spans, mean_directions
from talkingeyes.evaluation.detectors.signal import runs
from talkingeyes.evaluation.people.fixations import FixationRecord, Person, join_records, merge_fixations
from talkingeyes.physiology.gaze_population import STATES

DISPERSION_PX = 30.0
MIN_SAMPLES = 10  # at 90 Hz, the least that lasts 100 ms
BLINKS_PER_S = 0.33
CLOSED = 0.5  # of the lids; the tracker loses the pupil
RANGE_DEG = (38.0, 30.0)  # half width and height that the recordings cover around the middle of the screen


@dataclass(frozen=True)
class Tracker:
    """Settings of the simulated tracker."""

    noise_deg: float = 0.07  # SD of white noise, each axis
    drift_deg: float = 0.24  # SD of slow noise (first-order autoregressive), each axis
    drift_s: float = 0.5  # time constant of the slow noise
    loss_per_s: tuple[float, float] = (1.1, 0.58)  # hazard of a random loss while speaking, listening
    lost_s: float = 0.25  # mean length of a loss


TRACKER = Tracker()


@dataclass(frozen=True)
class GazeClip:
    """T frames of one person: gaze in space, state of each frame (index of STATES), lost frames."""

    fps: float
    gaze_deg: Float[ndarray, "T 2"]
    state: Int[ndarray, " T"]
    lost: Bool[ndarray, " T"]


@dataclass(frozen=True)
class Samples:
    """T samples at 90 Hz: position on the screen (left and up of its middle), state, lost samples."""

    px: Float[ndarray, "T 2"]
    state: Int[ndarray, " T"]
    lost: Bool[ndarray, " T"]


def track(clip: GazeClip, middle_deg: Float[ndarray, " 2"], tracker: Tracker, rng: np.random.Generator) -> Samples:
    """Record a clip with the tracker; `middle_deg` is the direction of the middle of the screen."""
    seconds = (len(clip.gaze_deg) - 1) / clip.fps
    times_s = np.arange(int(seconds * CONVERSATION_RATE_HZ) + 1) / CONVERSATION_RATE_HZ
    frames = np.arange(len(clip.gaze_deg)) / clip.fps
    gaze = np.stack([np.interp(times_s, frames, clip.gaze_deg[:, axis]) for axis in (0, 1)], axis=1) - middle_deg
    nearest = np.minimum(np.rint(times_s * clip.fps).astype(int), len(frames) - 1)
    state = clip.state[nearest]
    lost = clip.lost[nearest] | (np.abs(gaze) > RANGE_DEG).any(axis=1) | ~np.isfinite(gaze).all(axis=1)
    lost |= _random_losses(state, tracker, rng)
    gaze = gaze + _noise_deg(len(gaze), tracker, rng)
    px = np.tan(np.radians(gaze)) * CONVERSATION_CM / CONVERSATION_CM_PER_PX
    return Samples(px, state, lost)


def _noise_deg(samples: int, tracker: Tracker, rng: np.random.Generator) -> Float[ndarray, "T 2"]:
    """White noise and slow noise."""
    memory = np.exp(-1 / (tracker.drift_s * CONVERSATION_RATE_HZ))
    steps = rng.normal(0, tracker.drift_deg * np.sqrt(1 - memory**2), (samples, 2))
    steps[0] = rng.normal(0, tracker.drift_deg, 2)
    return np.asarray(lfilter([1], [1, -memory], steps, axis=0) + rng.normal(0, tracker.noise_deg, (samples, 2)))


def _random_losses(state: Int[ndarray, " T"], tracker: Tracker, rng: np.random.Generator) -> Bool[ndarray, " T"]:
    """Losses that begin at random, as often as the state has them."""
    hazard = np.array(tracker.loss_per_s)[state] / CONVERSATION_RATE_HZ
    lost = np.zeros(len(state), bool)
    for start in np.flatnonzero(rng.random(len(state)) < hazard):
        lost[start : start + 1 + int(rng.exponential(tracker.lost_s) * CONVERSATION_RATE_HZ)] = True
    return lost


def detect_screen_fixations(samples: Samples) -> dict[str, FixationRecord]:
    """Fixations by state, as the data set has them; not merged."""
    centre_deg = np.degrees(np.arctan(samples.px * CONVERSATION_CM_PER_PX / CONVERSATION_CM))
    valid = runs(~samples.lost)
    rows: list[tuple[int, int, int, int]] = []  # state, segment, start, stop
    segments = 0
    for first, last in zip(valid.first, valid.last, strict=True):
        in_run = low_dispersion_spans(samples.px[first : last + 1], MIN_SAMPLES, _is_fixation)
        spans = [(first + start, first + end + 1) for start, end in in_run]
        for state, group in groupby(spans, key=lambda span: int(samples.state[span[0]])):
            rows += [(state, segments, *span) for span in list(group)[:-1]]
            segments += 1
    table = np.array(rows, int).reshape(-1, 4)
    found: dict[str, FixationRecord] = {}
    for index, name in enumerate(STATES):
        _, segment, start, stop = table[table[:, 0] == index].T
        centre = mean_directions(np.where(samples.lost[:, None], 0.0, centre_deg), start, stop - 1)
        times = (start / CONVERSATION_RATE_HZ, (stop - start) / CONVERSATION_RATE_HZ)
        found[name] = FixationRecord(segment, *times, centre)
    return found


def _is_fixation(x_extent_px: float, y_extent_px: float) -> bool:
    return max(x_extent_px, y_extent_px) <= DISPERSION_PX


def record_person(name: str, clips: Sequence[GazeClip], tracker: Tracker, rng: np.random.Generator) -> Person:
    """Record all clips of a person; the screen's middle is the median direction of the gaze."""
    frames = np.concatenate([clip.gaze_deg[~clip.lost] for clip in clips])
    middle = np.median(frames, axis=0) if len(frames) else np.zeros(2)
    found = [detect_screen_fixations(track(clip, middle, tracker, rng)) for clip in clips]
    return Person(name, {state: merge_fixations(join_records([each[state] for each in found])) for state in STATES})


def record_again(person: Person, tracker: Tracker, rng: np.random.Generator) -> Person:
    """A recorded person, fixations one after the other without the gaps between segments, recorded by this tracker.

    What differs from the person is due to the simulated tracker, and to the joins, which add large shifts.
    """
    clips = []
    for state, record in enumerate(person.records.values()):
        if not len(record):
            continue
        samples = np.maximum(1, np.rint(record.time_s * CONVERSATION_RATE_HZ)).astype(int)
        gaze = np.repeat(record.centre_deg, samples, axis=0)
        clips.append(GazeClip(CONVERSATION_RATE_HZ, gaze, np.full(len(gaze), state), np.zeros(len(gaze), bool)))
    # Blinks are not in the fixations: all losses are random.
    losses = tuple(rate + BLINKS_PER_S for rate in tracker.loss_per_s)
    return record_person(person.name, clips, replace(tracker, loss_per_s=(losses[0], losses[1])), rng)


HOLD_S = (0.2, 5.0)
HALF_RANGE_DEG = (20.0, 10.0)  # of yaw and pitch: what eyes do without the head


def uniform_gaze_deg(frames: int, fps: float, rng: np.random.Generator) -> Float[ndarray, "T 2"]:
    """Gaze in space of T frames."""
    gaze, start = np.empty((frames, 2)), 0
    while start < frames:
        stop = start + max(1, round(rng.uniform(*HOLD_S) * fps))
        gaze[start:stop] = rng.uniform(-1, 1, 2) * HALF_RANGE_DEG
        start = stop
    return gaze
