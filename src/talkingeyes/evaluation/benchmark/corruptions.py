"""Corruptions of true motion that test which metrics detect them: freezing, jitter, delay, mirroring, smoothing.

A metric that does not rank the truth above a corruption cannot detect it (docs/results/sensitivity.md). Each corruption
has a strength: 0 leaves the motion unchanged, 1 is the fault as it occurs in practice (a flipped sign, a filter of
three frames, the noise of a cheap tracker). A dose is a strength in units of the fault (degrees, seconds, a fraction).
Signs: docs/conventions.md.

Blinks are corrupted as animation systems do: shallow, slow, missing, by a timer. Lid closure is split into blinks, from
the frame before each detected onset to three frames after its offset, where the lids still open, and the course between
(interpolated across blinks). Only the blinks change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from talkingeyes.core.rotation import eye_in_head, gaze_in_space
from talkingeyes.evaluation.detectors.behaviour import FIELDS, Behaviour

SHALLOW_FACTOR = 0.5  # closure that is left
SLOW_EXTENSION = 1.0  # fraction of its duration by which a blink becomes longer
MISSING_FRACTION = 0.5
FRAMES_BEFORE, FRAMES_AFTER = 1, 3


@dataclass(frozen=True)
class BlinkClosure:
    """First frame of a blink, and the closure of both lids that it adds in its frames."""

    first: int
    closure: Float[ndarray, "F 2"]


def shallow_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Close the lids less far in every blink."""
    depth = 1 - strength * (1 - SHALLOW_FACTOR)
    return _with_blinks(motion, [replace(each, closure=depth * each.closure) for each in _blinks(motion)])


def slow_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Make every blink longer, from the same first frame on."""
    return _with_blinks(motion, [_stretched(each, 1 + strength * SLOW_EXTENSION) for each in _blinks(motion)])


def missing_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Leave out blinks at random."""
    blinks = _blinks(motion)
    kept = rng.random(len(blinks)) >= strength * MISSING_FRACTION
    return _with_blinks(motion, [blink for blink, keep in zip(blinks, kept, strict=True) if keep])


def timed_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Move the blinks of a clip to equal intervals."""
    blinks = _blinks(motion)
    even = (np.arange(len(blinks)) + rng.random()) * len(motion) / max(len(blinks), 1)
    moved = [
        replace(blink, first=round(blink.first + strength * (first - blink.first)))
        for blink, first in zip(blinks, even, strict=True)
    ]
    return _with_blinks(motion, moved)


def _stretched(blink: BlinkClosure, factor: float) -> BlinkClosure:
    frames = np.arange(len(blink.closure))
    position = np.arange(round(factor * frames[-1]) + 1) / factor
    lids = [np.interp(position, frames, lid) for lid in blink.closure.T]
    return replace(blink, closure=np.stack(lids, axis=-1))


def _blinks(motion: Behaviour) -> list[BlinkClosure]:
    """The detected blinks; none without lids."""
    if motion.lid is None:
        return []
    closure = motion.lid - _lids_between_blinks(motion)
    return [BlinkClosure(first, closure[first : last + 1]) for first, last in _frames(motion)]


def _with_blinks(motion: Behaviour, blinks: Sequence[BlinkClosure]) -> Behaviour:
    """The motion with these blinks in place of its own, the larger closure where two overlap."""
    if motion.lid is None:
        return motion
    closure = np.zeros_like(motion.lid)
    for blink in blinks:
        inside = closure[blink.first : blink.first + len(blink.closure)]
        change = blink.closure[: len(inside)]
        np.copyto(inside, change, where=np.abs(change) > np.abs(inside))
    return replace(motion, lid=_lids_between_blinks(motion) + closure)


def _lids_between_blinks(motion: Behaviour) -> Float[ndarray, "T 2"]:
    assert motion.lid is not None
    lid = motion.lid.copy()
    for first, last in _frames(motion):
        lid[first : last + 1] = np.linspace(motion.lid[first], motion.lid[last], last - first + 1)
    return lid


def _frames(motion: Behaviour) -> list[tuple[int, int]]:
    """First and last frame of each blink."""
    first = np.floor(motion.blinks.onset_s * motion.fps).astype(int) - FRAMES_BEFORE
    last = np.ceil(motion.blinks.offset_s * motion.fps).astype(int) + FRAMES_AFTER
    edges = np.clip(np.stack([first, last], axis=-1), 0, len(motion) - 1)
    return [(int(one), int(two)) for one, two in edges]


HEAD_AND_EYES = ("head", "gaze")
JITTER_RAD = np.radians(0.3)
DELAY_S = 3.0
SMOOTH_S = 0.12
EYE_DELAY_S = 0.12
HEAD_DELAY_S = 0.4
SHRINK_FACTOR = 0.5
DIVERGENCE_RAD = np.radians(2.0)
TORSION_PER_YAW = 0.3  # fraction of yaw: false torsion of an eye rotated about fixed axes
DRIFT_RAD, DRIFT_S = np.radians(3.0), 2.0
HALVINGS = 7  # the smallest dose is 1/128 of the largest
DOSE_FPS = 25.0  # delays are doses of whole frames

# Maps the frames of one field.
FrameTransform = Callable[[ndarray], ndarray]
MotionTransform = Callable[[Behaviour, float, np.random.Generator], Behaviour]


@dataclass(frozen=True)
class Corruption:
    """A corruption: name, description, and the function that applies it to a motion.

    `doses` are ascending sizes in `unit`, the last that of strength 1; a corruption without a size has none.
    """

    name: str
    title: str
    change: MotionTransform
    doses: tuple[float, ...] = ()
    unit: str = ""

    def strength(self, dose: float) -> float:
        """Strength of a dose."""
        return dose / self.doses[-1]


def apply_corruption(
    motions: Sequence[Behaviour], speakers: Sequence[str], corruption: Corruption, strength: float, seed: int
) -> list[Behaviour]:
    """Corrupt all motions; sounds and references are unchanged. `speakers` restricts swaps to other speakers."""
    if corruption.name == SWAPPED.name:
        return _swapped(motions, speakers, strength, np.random.default_rng(seed))
    return [corruption.change(each, strength, np.random.default_rng([seed, n])) for n, each in enumerate(motions)]


def _frozen(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Freeze the last part of the clip."""
    last = round((1 - strength) * (len(motion) - 1))
    return _map(motion, lambda path: path[np.minimum(np.arange(len(path)), last)])


def _jittered(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Add white noise to every angle of head and eyes, as from a tracker without temporal smoothing."""
    return _map(motion, lambda path: path + strength * JITTER_RAD * rng.standard_normal(path.shape), *HEAD_AND_EYES)


def _delayed(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Delay motion relative to the sound, wrapping around at the end of the clip; the seam is marked invalid."""
    shift = round(strength * DELAY_S * motion.fps)
    valid = np.roll(motion.valid, shift)
    if shift:
        valid[[shift - 1, shift]] = False
    return replace(_map(motion, lambda path: np.roll(path, shift, axis=0)), valid=valid)


def _mirrored_sides(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Mirror head and eyes left to right (in a fraction `strength` of the clips)."""
    if rng.random() >= strength:
        return motion
    return replace(
        motion,
        head=None if motion.head is None else motion.head * [1.0, -1.0, -1.0],
        gaze=None if motion.gaze is None else motion.gaze[:, ::-1] * [1.0, -1.0, -1.0],
        lid=None if motion.lid is None else motion.lid[:, ::-1],
    )


def _smoothed(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Smooth head and eyes with a Gaussian filter over time."""
    frames = strength * SMOOTH_S * motion.fps
    return _map(motion, lambda path: gaussian_filter1d(path, frames, axis=0) if frames else path, *HEAD_AND_EYES)


def _diverging_eyes(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Rotate each eye outwards."""
    outwards = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    return _map(motion, lambda gaze: gaze + strength * DIVERGENCE_RAD * outwards, "gaze")


def _false_torsion(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Add torsion proportional to yaw, against Listing's law."""
    return _map(motion, lambda gaze: gaze + strength * TORSION_PER_YAW * gaze[..., 1:2] * [0.0, 0.0, 1.0], "gaze")


def _delayed_eyes(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Delay the eyes by a few frames relative to the head."""
    behind = round(strength * EYE_DELAY_S * motion.fps)
    return _map(motion, lambda gaze: gaze[np.maximum(np.arange(len(gaze)) - behind, 0)], "gaze")


def _fixed_head(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Hold the head at its mean pose; the eyes keep gaze in space unchanged."""
    return _with_head(motion, lambda head: head + strength * (head.mean(axis=0) - head))


def _delayed_head(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Delay the head; gaze in space is unchanged."""
    behind = round(strength * HEAD_DELAY_S * motion.fps)
    return _with_head(motion, lambda head: head[np.maximum(np.arange(len(head)) - behind, 0)])


def _with_head(motion: Behaviour, change: FrameTransform) -> Behaviour:
    """Transform the head alone; gaze in space is unchanged."""
    if motion.head is None or motion.gaze is None:
        return motion
    head = change(motion.head)
    return replace(motion, head=head, gaze=eye_in_head(head, gaze_in_space(motion.head, motion.gaze)))


def _reduced_amplitude(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Scale head and eyes about their mean by `SHRINK_FACTOR`."""
    gain = 1 - strength * (1 - SHRINK_FACTOR)
    return _map(motion, lambda path: path.mean(axis=0) + gain * (path - path.mean(axis=0)), *HEAD_AND_EYES)


def _mean_pose(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Hold the clip's mean pose, which has the best L2."""
    return _map(motion, lambda path: path + strength * (path.mean(axis=0) - path))


def _without_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Remove blinks, so that lids only follow gaze."""
    return _map(motion, lambda lid: (1 - strength) * lid, "lid")


def _delayed_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Delay the lids only."""
    shift = round(strength * DELAY_S * motion.fps)
    return _map(motion, lambda lid: np.roll(lid, shift, axis=0), "lid")


def _drifting_head(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Let head yaw drift to the left and snap back every DRIFT_S, as a gyroscope that is recentred."""
    phase = (motion.times_s / DRIFT_S + rng.random()) % 1.0 - 0.5
    return _map(motion, lambda head: head + strength * DRIFT_RAD * phase[:, None] * [0.0, 1.0, 0.0], "head")


def _unchanged(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    return motion


def _swapped(
    motions: Sequence[Behaviour], speakers: Sequence[str], strength: float, rng: np.random.Generator
) -> list[Behaviour]:
    """Replace each motion by one of another speaker, cut to the shorter length."""
    found = []
    for motion, speaker in zip(motions, speakers, strict=True):
        others = [index for index, other in enumerate(speakers) if other != speaker]
        if not others or rng.random() >= strength:
            found.append(motion)
            continue
        taken = motions[int(rng.choice(others))]
        cut = _map(taken, itemgetter(slice(len(motion))))
        found.append(
            replace(cut, valid=taken.valid[: len(motion)], annotation=motion.annotation, reference=motion.reference)
        )
    return found


def _map(motion: Behaviour, change: FrameTransform, *fields: str) -> Behaviour:
    """Transform these fields of a motion, without names all of them; a field that is None stays None."""
    present = [name for name in fields or FIELDS if motion.has(name)]
    changed: dict[str, Any] = {name: change(getattr(motion, name)) for name in present}
    return replace(motion, **changed)


def _in_some_clips(change: FrameTransform, *fields: str) -> MotionTransform:
    """A corruption that transforms these fields in a fraction `strength` of the clips."""
    return lambda motion, strength, rng: _map(motion, change, *fields) if rng.random() < strength else motion


def _halvings(largest: float) -> tuple[float, ...]:
    """Doses from `largest` / 128 to `largest`, each twice the one before."""
    return tuple(float(largest) / 2**halving for halving in range(HALVINGS, -1, -1))


def _delays(largest_s: float) -> tuple[float, ...]:
    """These doses in whole frames."""
    return tuple(sorted({max(1, round(each * DOSE_FPS)) / DOSE_FPS for each in _halvings(largest_s)}))


def _percent(largest: float) -> tuple[float, ...]:
    """Doses of a fraction, in percent."""
    return _halvings(100 * largest)


MIRRORED_HEIGHTS = _in_some_clips(lambda path: path * [-1.0, 1.0, -1.0], *HEAD_AND_EYES)
FLIPPED_EYES = _in_some_clips(np.negative, "gaze")
FLIPPED_EYE_YAW = _in_some_clips(lambda gaze: gaze * [1.0, -1.0, 1.0], "gaze")
DEGREES, SECONDS, CLIPS = "deg", "s", "% of clips"
UNCORRUPTED = Corruption("uncorrupted", "truth: another take", _unchanged)
SWAPPED = Corruption("swapped speaker", "another speaker's motion", _unchanged, _percent(1.0), CLIPS)
CORRUPTIONS = (
    Corruption("frozen", "frozen at the first frame", _frozen, _percent(1.0), "% of each clip"),
    Corruption("mean pose", "frozen at the clip's mean", _mean_pose),
    Corruption("jittered", "0.3 deg of white noise", _jittered, _halvings(0.3), DEGREES),
    Corruption("smoothed", "Gaussian filter of 0.12 s", _smoothed, _halvings(SMOOTH_S), SECONDS),
    Corruption("reduced amplitude", "amplitude halved", _reduced_amplitude, _percent(1 - SHRINK_FACTOR), "% lost"),
    Corruption("delayed", "3 s late", _delayed, _delays(DELAY_S), SECONDS),
    SWAPPED,
    Corruption("mirrored left-right", "mirrored left to right", _mirrored_sides, _percent(1.0), CLIPS),
    Corruption("mirrored up-down", "mirrored upside down", MIRRORED_HEIGHTS, _percent(1.0), CLIPS),
    Corruption("flipped eyes", "sign of eye rotation flipped", FLIPPED_EYES, _percent(1.0), CLIPS),
    Corruption("flipped eye yaw", "sign of eye yaw flipped", FLIPPED_EYE_YAW, _percent(1.0), CLIPS),
    Corruption("diverging eyes", "each eye rotated 2 deg outwards", _diverging_eyes, _halvings(2.0), DEGREES),
    Corruption(
        "false torsion", "torsion of 0.3 times yaw added", _false_torsion, _percent(TORSION_PER_YAW), "% of yaw"
    ),
    Corruption("delayed eyes", "eyes 0.12 s behind the head", _delayed_eyes, _delays(EYE_DELAY_S), SECONDS),
    Corruption("delayed head", "head 0.4 s behind gaze", _delayed_head, _delays(HEAD_DELAY_S), SECONDS),
    Corruption("fixed head", "head still, gaze moved by the eyes only", _fixed_head, _percent(1.0), "% lost"),
    Corruption("drifting head", "head drifts 3 deg in 2 s and snaps back", _drifting_head, _halvings(3.0), DEGREES),
    Corruption("no blinks", "no blinks", _without_blinks),
    Corruption("delayed blinks", "blinks 3 s late", _delayed_blinks, _delays(DELAY_S), SECONDS),
    Corruption("missing blinks", "half of the blinks missing", missing_blinks, _percent(MISSING_FRACTION), "% missing"),
    Corruption("shallow blinks", "lids close half as far", shallow_blinks, _percent(1 - SHALLOW_FACTOR), "% lost"),
    Corruption("slow blinks", "blinks twice as long", slow_blinks, _percent(SLOW_EXTENSION), "% longer"),
    Corruption("timed blinks", "blinks at equal intervals", timed_blinks, _percent(1.0), "% of the way"),
)
