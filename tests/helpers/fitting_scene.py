"""A small scene for tests of fitting: known motion and a simulated observation with detector noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.motion import Blink, Events, Motion, Saccade
from talkingeyes.core.rotation import eye_in_head
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmarks import head_to_scene, landmarks, pupil_centres
from talkingeyes.head.observation import Observation
from talkingeyes.physiology import saccades as main_sequence_model

FPS = 25.0
CAMERA = Camera(focal_px=1154 * 0.925, centre_px=(112.0, 120.0), distance_m=1.0, width=224, height=224)  # 1.154 px/mm
KAPPA_RAD = np.radians([[4.5, 0.0], [-4.5, 0.0]])  # optical axes diverge


@dataclass(frozen=True)
class Scene:
    """A true motion with its events, and its observation."""

    motion: Motion
    events: Events
    observation: Observation


def scene(seed: int, frames: int = 220, noise: float = 1.0, blinks: bool = True) -> Scene:
    """Conversational gaze of `frames` frames; `noise` scales the detector errors, 0 gives exact observations."""
    rng = np.random.default_rng(seed)
    seconds = frames / FPS
    times_s = np.arange(frames) / FPS
    shifts = draw_saccades(seconds, rng)
    space = (
        main_sequence_model.gaze_path(shifts, (0.0, 0.0), times_s)[:, None]
        + KAPPA_RAD
        + np.radians([[-1.2, 0.0], [1.2, 0.0]])
    )
    closures = sample_blinks(seconds, rng) if blinks else ()
    head = head_sway(times_s, np.radians([2.5, 4.0, 2.0]), rng)
    lid = np.clip(closure(closures, times_s)[:, None] + np.zeros((1, 2)), 0, 1)
    jaw = np.zeros((frames, 3))
    jaw[:, 0] = 0.1 * np.abs(np.sin(2 * np.pi * 2.5 * times_s))
    translation = head_sway(times_s, np.array([0.004, 0.003, 0.003]), rng)
    motion = Motion.of(FPS, head, eye_in_head(head, space), translation=translation, lid=lid, jaw=jaw)
    return Scene(motion, Events(shifts, (), closures), observe(motion, rng, noise))


def observe(motion: Motion, rng: np.random.Generator, noise: float) -> Observation:
    """Landmarks and pupils in pixels; a pupil is hidden while its eye is open by less than 0.35."""
    points = landmarks(motion.gaze, motion.lid, motion.jaw)
    marks = CAMERA.project(head_to_scene(points, motion.head, motion.translation))
    exact = CAMERA.project(head_to_scene(pupil_centres(motion.gaze), motion.head, motion.translation))
    marks = marks + noise * rng.normal(0, 0.3, marks.shape)
    seen = exact + noise * pupil_error(exact, motion, rng)
    seen[motion.lid > 0.65] = np.nan
    return Observation(motion.fps, marks, seen, np.ones(len(motion)), CAMERA)


def pupil_error(exact: Float[ndarray, "T 2 2"], motion: Motion, rng: np.random.Generator) -> Float[ndarray, "T 2 2"]:
    """The raw detector: bias, slow error, white noise, gain below 1, rare bursts."""
    frames = len(exact)
    shared, own = rng.normal(size=(1, 1, 2)), rng.normal(size=(1, 2, 2))
    bias = 0.35 * (np.sqrt(0.6) * shared + np.sqrt(0.4) * own)
    slow = np.zeros((frames, 2, 2))
    slow[0] = rng.normal(0, 0.35, (2, 2))
    for frame in range(1, frames):
        slow[frame] = 0.95 * slow[frame - 1] + rng.normal(0, 0.35 * np.sqrt(1 - 0.95**2), (2, 2))
    white = rng.normal(0, rng.uniform(0.15, 0.30), (frames, 2, 2))
    at_rest = CAMERA.project(head_to_scene(pupil_centres(0 * motion.gaze), motion.head, motion.translation))
    gain = np.array([rng.uniform(0.92, 1.0), rng.uniform(0.80, 0.95)])
    error = (bias + slow + white) * (1 + 0.5 * np.abs(motion.head[:, 1]) / np.radians(30))[:, None, None]
    error += (gain - 1) * (exact - at_rest)
    for start in np.flatnonzero(rng.random(frames) < 0.005):
        angle, eye = rng.uniform(0, 2 * np.pi), rng.integers(2)
        burst = rng.uniform(3, 6) * np.array([np.cos(angle), np.sin(angle)])
        error[start : start + rng.integers(1, 4), eye] += burst
    return error


def draw_saccades(seconds: float, rng: np.random.Generator) -> tuple[Saccade, ...]:
    """About 1.5 saccades per second between directions within about 15 degrees."""
    shifts: list[Saccade] = []
    onset, here = rng.uniform(0.2, 0.6), np.zeros(2)
    while onset < seconds - 0.2:
        there = np.clip(here * 0.4 + rng.normal(0, np.radians([6.0, 3.5])), -0.4, 0.3)
        shifts.append(main_sequence_model.sample_saccade(onset, here, there, rng))
        here, onset = there, onset + max(0.2, float(rng.lognormal(np.log(0.55), 0.6)))
    return tuple(shifts)


def sample_blinks(seconds: float, rng: np.random.Generator) -> tuple[Blink, ...]:
    """Blinks at about 24 per minute."""
    found: list[Blink] = []
    onset = rng.uniform(0.3, 2.0)
    while onset < seconds - 0.5:
        depth = 1.0 if rng.random() < 0.7 else rng.uniform(0.5, 0.9)
        found.append(Blink(onset, 0.085, 0.025, 0.21, depth))
        onset += 0.6 + rng.gamma(2.0, 1.0)
    return tuple(found)


def closure(blinks: tuple[Blink, ...], times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
    """Lid closure of trapezoid blinks."""
    lid = np.zeros(len(times_s))
    for blink in blinks:
        knots = np.cumsum([blink.onset_s, blink.closing_s, blink.hold_s, blink.opening_s])
        lid = np.maximum(lid, blink.depth * np.interp(times_s, knots, [0.0, 1.0, 1.0, 0.0]))
    return lid


def head_sway(
    times_s: Float[ndarray, " T"], size: Float[ndarray, " C"], rng: np.random.Generator
) -> Float[ndarray, "T C"]:
    """Slow sway and some nods: sinusoids from 0.1 to 2 Hz of decreasing amplitude."""
    rate = np.array([0.1, 0.23, 0.5, 1.1, 2.0])[:, None, None]
    phase = rng.uniform(0, 2 * np.pi, (5, 1, len(size)))
    waves = np.sin(2 * np.pi * rate * times_s[:, None] + phase) / (1 + 3 * rate)
    return np.asarray(size * waves.sum(axis=0))
