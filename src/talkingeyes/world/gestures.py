"""What the head does with speech: posture, nods and beats on stressed syllables, and its unrest in three bands.

Bands, their link to speaking, postural shifts at the onset of speech and rapid movements at stress are those of Hadar
et al. (1983, 1984); nods are down- and up-strokes about a stressed vowel, on some syllables only (FACTS, section 3).
A nod of one take is not a nod of the next. Angles are radians, times seconds.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.motion import HeadMove
from talkingeyes.physiology.render import Curve, Waves
from talkingeyes.world.speakers import Style

BANDS_HZ = {"slow": (0.06, 1.8), "ordinary": (1.8, 3.7), "rapid": (3.7, 7.0)}
BAND_DEG = {"slow": (3.4, 2.0, 1.7), "ordinary": (0.20, 0.24, 0.14), "rapid": (0.05, 0.07, 0.04)}
BAND_SINES = {"slow": 14, "ordinary": 6, "rapid": 4}
BAND_SLOPE = {"slow": 1.1, "ordinary": 1.5, "rapid": 1.5}
STILL = 0.3
POSTURE_SHIFT, POSTURE_DEG = 0.45, (1.5, 3.0, 1.5)
NOD_DEG, NOD_S, NOD_SLACK_S = (1.5, 4.5), (0.2, 0.35), 0.05
PLAIN_SYLLABLE = 0.04
FINAL_NOD, FINAL_NOD_DEG = 0.30, (2.0, 5.0)
LEAST_BETWEEN_NODS_S = 0.6


def band(name: str, scale: float, random: np.random.Generator) -> Waves:
    """Unrest of one band: axes pitch, yaw, roll independent; slower parts are larger."""
    low, high = BANDS_HZ[name]
    count = BAND_SINES[name]
    edges = np.geomspace(low, high, count + 1)
    frequency = random.uniform(edges[:-1], edges[1:])
    weight = frequency ** -BAND_SLOPE[name]
    yaw, pitch, roll = BAND_DEG[name]
    deviation = np.radians([pitch, yaw, roll]) * scale
    drawn = weight[:, None] * np.sqrt(-2.0 * np.log(random.uniform(1e-3, 1.0, (count, 3))))
    norm = np.sqrt((weight**2).sum())
    return Waves(frequency, drawn * deviation / norm, random.uniform(0.0, 2.0 * np.pi, (count, 3)))


def joined(*waves: Waves) -> Waves:
    """Sinusoids of several bands as one sum."""
    return Waves(
        *(np.concatenate([getattr(w, name) for w in waves]) for name in ("frequency_hz", "amplitude", "phase_rad"))
    )


def activity(annotation: Annotation) -> Curve:
    """How far the head is alive with speech: 1 while speaking, STILL in silence, with ramps."""
    spans: list[list[float]] = []
    for span in annotation.speaking:
        if spans and span.start_s - spans[-1][1] < 0.8:
            spans[-1][1] = span.end_s
        else:
            spans.append([span.start_s, span.end_s])
    knots = [(t, v) for a, b in spans for t, v in ((a - 0.3, STILL), (a, 1.0), (b + 0.1, 1.0), (b + 0.4, STILL))]
    knots = knots or [(0.0, STILL)]
    return Curve(np.array([t for t, _ in knots]), np.array([v for _, v in knots]))


def posture_shifts(annotation: Annotation, style: Style, random: np.random.Generator) -> list[HeadMove]:
    """Wide linear shifts when speech starts again after a pause; they lead back towards the middle."""
    moves: list[HeadMove] = []
    pose = np.zeros(3)
    for span in annotation.speaking:
        if random.random() < POSTURE_SHIFT * (0.5 + 0.5 * style.coupling):
            target = np.radians(POSTURE_DEG) * style.head_scale * random.standard_normal(3)
            move = HeadMove(span.start_s + random.normal(-0.1, 0.2), random.uniform(0.5, 0.9), _triple(target - pose))
            moves, pose = [*moves, move], target
    return moves


def nods(annotation: Annotation, style: Style, random: np.random.Generator) -> list[HeadMove]:
    """Beats on some stressed syllables, a few on others, and some phrase-final nods."""
    moves: list[HeadMove] = []
    last = -np.inf
    for apex, size in sorted(_apexes(annotation, style, random)):
        down = random.uniform(*NOD_S)
        if apex - down < last + LEAST_BETWEEN_NODS_S:
            continue
        depth = np.radians(size) * style.head_scale**0.7
        up, rise = down * random.uniform(1.0, 1.5), depth * random.uniform(0.85, 1.1)
        moves.append(HeadMove(float(apex - down), float(down), (float(depth), 0.0, 0.0)))
        moves.append(HeadMove(float(apex), float(up), (-float(rise), 0.0, 0.0)))
        last = apex
    return moves


def _apexes(annotation: Annotation, style: Style, random: np.random.Generator) -> list[tuple[float, float]]:
    """When nods are lowest, and how deep they are in degrees."""
    apexes = []
    for phoneme in annotation.phonemes:
        chance = style.nod_probability * (0.4 + 0.6 * style.coupling) if phoneme.stressed else PLAIN_SYLLABLE / 2
        if random.random() < chance:
            middle = (phoneme.start_s + phoneme.end_s) / 2
            apexes.append((middle + NOD_SLACK_S * random.standard_normal(), random.uniform(*NOD_DEG)))
    for span in annotation.speaking:
        if random.random() < FINAL_NOD:
            apexes.append((span.end_s + random.uniform(-0.2, 0.1), random.uniform(*FINAL_NOD_DEG)))
    return apexes


def translation(random: np.random.Generator) -> Waves:
    """Slow sway of the head's joint: a few millimetres, most in depth."""
    frequency = random.uniform(0.05, 0.5, 5)
    amplitude = np.array([0.003, 0.0015, 0.004]) * random.rayleigh(0.6, (5, 3))
    return Waves(frequency, amplitude, random.uniform(0.0, 2.0 * np.pi, (5, 3)))


def _triple(rotation_vector: Float[ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in rotation_vector)
    return x, y, z
