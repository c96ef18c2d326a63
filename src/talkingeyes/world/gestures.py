"""What the head does with speech: posture, nods and beats on stressed syllables, and its unrest in three bands.

Bands, their link to speaking, postural shifts at the onset of speech and rapid movements at stress are those of Hadar
et al. (1983, 1984); nods are down- and up-strokes about a stressed vowel, on some syllables only (FACTS, section 3).
A nod of one take is not a nod of the next. Angles are radians, times seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.motion import HeadMove
from talkingeyes.physiology.render import Curve, Waves
from talkingeyes.world.speakers import Style


@dataclass(frozen=True)
class Band:
    """A band of the head's unrest."""

    range_hz: tuple[float, float]
    deviation_deg: tuple[float, float, float]
    sines: int
    slope: float


# Frequencies, sizes (standard deviation of yaw, pitch, roll in degrees), number of sinusoids, and how amplitude falls
# with frequency. The drift of posture goes on in silence, the rest comes with speech.
BANDS = {
    "drift": Band((0.1, 0.42), (3.2, 1.6, 1.6), 8, 0.8),
    "slow": Band((0.5, 1.8), (1.2, 1.0, 0.8), 6, 1.1),
    "ordinary": Band((1.8, 3.7), (0.11, 0.11, 0.07), 6, 0.8),
    "rapid": Band((3.7, 7.0), (0.055, 0.06, 0.04), 4, 0.6),
}
STILL, LEAST_SILENCE_S = 0.06, 0.4
STARTING_SHIFT, ENDING_SHIFT, POSTURE_DEG = 0.85, 0.85, (1.0, 2.2, 1.2)
NOD_DEG, NOD_S, NOD_SLACK_S = (1.5, 4.0), (0.30, 0.44), 0.05
PLAIN_SYLLABLE = 0.04
FINAL_NOD, FINAL_NOD_DEG = 0.30, (2.0, 5.0)
LEAST_BETWEEN_NODS_S = 0.7


def unrest(band: Band, scale: float, random: np.random.Generator) -> Waves:
    """Sinusoids of one band, axes independent; slower ones are larger."""
    edges = np.geomspace(*band.range_hz, band.sines + 1)
    frequency = random.uniform(edges[:-1], edges[1:])
    weight = frequency**-band.slope
    yaw, pitch, roll = band.deviation_deg
    deviation = np.radians([pitch, yaw, roll]) * scale / np.sqrt((weight**2).sum())
    # Rayleigh amplitudes make each sinusoid a Gaussian draw: with this scale their variances add up to deviation^2.
    amplitude = weight[:, None] * deviation * random.rayleigh(1.0, (band.sines, 3))
    return Waves(frequency, amplitude, random.uniform(0.0, 2.0 * np.pi, (band.sines, 3)))


def joined(*waves: Waves) -> Waves:
    """Sinusoids of several bands as one sum."""
    return Waves(
        *(np.concatenate([getattr(w, name) for w in waves]) for name in ("frequency_hz", "amplitude", "phase_rad"))
    )


def activity(annotation: Annotation) -> Curve:
    """How far the head is alive with speech: 1 while speaking, STILL in silence, with ramps."""
    spans: list[list[float]] = []
    for span in annotation.speaking:
        if spans and span.start_s - spans[-1][1] < LEAST_SILENCE_S:
            spans[-1][1] = span.end_s
        else:
            spans.append([span.start_s, span.end_s])
    knots = [(t, v) for a, b in spans for t, v in ((a - 0.15, STILL), (a + 0.05, 1.0), (b, 1.0), (b + 0.2, STILL))]
    knots = knots or [(0.0, STILL)]
    return Curve(np.array([t for t, _ in knots]), np.array([v for _, v in knots]))


def posture_shifts(annotation: Annotation, style: Style, random: np.random.Generator) -> list[HeadMove]:
    """Wide linear shifts when speech starts after a pause, lifting the head a little; partly back when it ends."""
    moves: list[HeadMove] = []
    pose, lift = np.zeros(3), np.array([-style.speaking_lift, 0.0, 0.0])
    for span in annotation.speaking:
        for onset, chance, middle, spread in (
            (span.start_s, STARTING_SHIFT, lift, 1.0),
            (span.end_s - 0.5, ENDING_SHIFT, -lift / 2, 0.4),
        ):
            if random.random() < chance * (0.4 + 0.6 * style.coupling):
                target = style.head_scale * (middle + spread * np.radians(POSTURE_DEG) * random.standard_normal(3))
                turn = _triple(target - pose)
                moves.append(HeadMove(onset + random.normal(0.0, 0.15), random.uniform(0.5, 0.9), turn))
                pose = target
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
            apexes.append((span.end_s + random.uniform(-0.45, -0.1), random.uniform(*FINAL_NOD_DEG)))
    return apexes


def translation(random: np.random.Generator) -> Waves:
    """Slow sway of the head's joint: a few millimetres, most in depth."""
    frequency = random.uniform(0.05, 0.5, 5)
    amplitude = np.array([0.003, 0.0015, 0.004]) * random.rayleigh(0.6, (5, 3))
    return Waves(frequency, amplitude, random.uniform(0.0, 2.0 * np.pi, (5, 3)))


def _triple(rotation_vector: Float[ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in rotation_vector)
    return x, y, z
