"""Head gestures with speech: posture shifts, nods, beats on stressed syllables, and continuous motion in bands.

The frequency bands, their coupling to speech, posture shifts at the onset of speech and rapid movements at stress
follow Hadar et al. (1983, 1984). Nods are down- and up-strokes around a stressed vowel, on some syllables only, sampled
anew for each take. Lengths, cycles, rates and relative depths of nods are those of 1,578 nods of four people in German
conversation (github.com/jobschepens/cross-modal-head-nod-analysis); its amplitudes are of the nose in the picture, so
the scale of the depths is a choice. Angles are in radians, times in seconds.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Phoneme, Span
from talkingeyes.core.motion import HeadMovement
from talkingeyes.physiology.render import PiecewiseLinear, Sinusoids
from talkingeyes.synthesis.speakers import SpeakerStyle


@dataclass(frozen=True)
class FrequencyBand:
    """A frequency band of continuous head motion."""

    range_hz: tuple[float, float]
    deviation_deg: tuple[float, float, float]
    sines: int
    slope: float


# Frequencies, standard deviations (yaw, pitch, roll in degrees), number of sinusoids, and decay of amplitude with
# frequency. Postural drift continues in silence; the other bands scale with speech activity. Between 1.1 and 3.7 Hz,
# most power comes from nods, beats and head contributions to gaze shifts.
FREQUENCY_BANDS = {
    "drift": FrequencyBand((0.1, 0.42), (3.2, 1.6, 1.6), 8, 0.8),
    "slow": FrequencyBand((0.45, 1.1), (2.1, 1.3, 1.3), 7, 0.4),
    "ordinary": FrequencyBand((1.8, 3.7), (0.03, 0.02, 0.03), 6, -0.4),
    "rapid": FrequencyBand((3.7, 7.0), (0.11, 0.11, 0.08), 4, 0.6),
}
SILENT_ACTIVITY, MIN_SILENCE_S, RAMP_SPREAD_S = 0.06, 0.4, 0.15
POSTURE_SHIFT_PROBABILITY, LONG_PAUSE_S, POSTURE_DEG = 1.0, 0.5, (1.3, 1.0, 1.2)  # pitch, yaw, roll
# Nods and beats: depth (of nods: median of a log-normal), duration of the down-stroke (single nods last 0.80 s in the
# median), jitter of the apex around the middle of the stressed vowel.
NOD_DEG, NOD_S, NOD_SLACK_S = 2.7, (0.26, 0.46), 0.04
DEPTH_SPREAD, MAX_DEPTH_FACTOR = 0.6, 3.0
BEAT_DEG, BEAT_S = (1.0, 2.6), (0.30, 0.42)
UNSTRESSED_NOD_PROBABILITY, DEFAULT_PROMINENCE = 0.02, 0.5
FINAL_NOD_PROBABILITY, FINAL_NOD_DEG = 0.15, 3.3
MIN_NOD_DISTANCE_S, MIN_BEAT_DISTANCE_S = 0.7, 0.3
# Range of pitch between words of zero and usual loudness, and its timing: complete by the middle of a word.
LEAN_DEG, LEAN_AFTER_S, LEAN_SLACK_S, LEAN_S = 6.0, -0.15, 0.05, 0.30
# Nods of a listener after the end of a phrase of the partner: 6.7 times a minute of conversation; half of them single
# and slower, the number of cycles geometric. Strokes are halves of a cycle.
BACKCHANNEL_PROBABILITY, BACKCHANNEL_LATENCY_S, BACKCHANNEL_DEG = 0.5, (0.1, 0.5), 1.6
SINGLE_PROBABILITY, MAX_CYCLES = 0.5, 8
SINGLE_STROKE_S, REPEATED_STROKE_S, STROKE_SPREAD = 0.42, 0.31, 0.3


def idle_motion(band: FrequencyBand, style: SpeakerStyle, rng: np.random.Generator) -> Sinusoids:
    """Sample the sinusoids of one band, with independent axes and larger amplitudes at lower frequencies."""
    edges = style.head_tempo * np.geomspace(*band.range_hz, band.sines + 1)
    frequency = rng.uniform(edges[:-1], edges[1:])
    weight = frequency**-band.slope
    yaw, pitch, roll = band.deviation_deg
    deviation = np.radians([pitch, yaw, roll]) * style.head_axes * style.head_scale / np.sqrt((weight**2).sum())
    # Rayleigh amplitudes make each sinusoid Gaussian; with this scale, the variances add up to deviation^2.
    amplitude = weight[:, None] * deviation * rng.rayleigh(1.0, (band.sines, 3))
    return Sinusoids(frequency, amplitude, rng.uniform(0.0, 2.0 * np.pi, (band.sines, 3)))


def concatenate_sinusoids(*waves: Sinusoids) -> Sinusoids:
    """Join the sinusoids of several bands."""
    return Sinusoids(
        *(np.concatenate([getattr(w, name) for w in waves]) for name in ("frequency_hz", "amplitude", "phase_rad"))
    )


def motion_scale(annotation: Annotation, rng: np.random.Generator) -> PiecewiseLinear:
    """Speech-dependent scale of head motion: 1 while speaking, less in silence, with ramps.

    While listening it is SILENT_ACTIVITY (Hadar 1983). The level in a pause within a turn and the times of the ramps
    are sampled, so that the head does not reveal the pauses exactly.
    """
    knots: list[tuple[float, float]] = []
    end_s, level = -np.inf, SILENT_ACTIVITY
    for span in annotation.speaking:
        gap_s = span.start_s - end_s
        if knots and gap_s < MIN_SILENCE_S:
            knots.pop()
            knots.pop()
        else:
            is_listening = any(each.start_s < span.start_s and each.end_s > end_s for each in annotation.listening)
            level = SILENT_ACTIVITY if is_listening or not knots else max(SILENT_ACTIVITY, float(rng.uniform() ** 6))
            if knots:
                knots[-1] = (knots[-1][0], level)
            rise_s = max(span.start_s + RAMP_SPREAD_S * rng.standard_normal(), knots[-1][0] if knots else -np.inf)
            knots += [(rise_s - 0.15 if not knots else rise_s, level), (max(rise_s, span.start_s) + 0.1, 1.0)]
        end_s = span.end_s
        knots += [(end_s, 1.0), (end_s + 0.2, SILENT_ACTIVITY)]
    knots = knots or [(0.0, SILENT_ACTIVITY)]
    return PiecewiseLinear(np.array([t for t, _ in knots]), np.array([v for _, v in knots]))


def posture_shifts(annotation: Annotation, style: SpeakerStyle, rng: np.random.Generator) -> list[HeadMovement]:
    """Linear shifts of posture when speech starts after a long pause, with a small lift, and partly back at its end."""
    moves: list[HeadMovement] = []
    pose, lift = np.zeros(3), np.array([-style.speaking_lift, 0.0, 0.0])
    spans = annotation.speaking
    for index, span in enumerate(spans):
        before_s = span.start_s - spans[index - 1].end_s if index else np.inf
        after_s = spans[index + 1].start_s - span.end_s if index + 1 < len(spans) else np.inf
        for onset, pause_s, middle, spread in (
            (span.start_s, before_s, lift, 1.0),
            (span.end_s - 0.2, after_s, -lift / 2, 0.4),
        ):
            if pause_s >= LONG_PAUSE_S and rng.random() < POSTURE_SHIFT_PROBABILITY * (
                0.4 + 0.6 * style.speech_coupling
            ):
                target = style.head_scale * (middle + spread * np.radians(POSTURE_DEG) * rng.standard_normal(3))
                duration = float(rng.uniform(0.5, 0.9) / style.head_tempo)
                moves.append(HeadMovement(float(onset + rng.normal(0.0, 0.15)), duration, _triple(target - pose)))
                pose = target
    return moves


@dataclass(frozen=True)
class Nod:
    """A nod: time and depth of its lowest point, and duration of the down-stroke."""

    apex_s: float
    depth_deg: float
    down_s: float


def sample_nods(annotation: Annotation, style: SpeakerStyle, rng: np.random.Generator) -> list[HeadMovement]:
    """Sample nods on some stressed, few unstressed and some phrase-final syllables; beats on other stressed ones."""
    large = _keep_spaced([], _nods(annotation, style, rng), MIN_NOD_DISTANCE_S)
    moves: list[HeadMovement] = []
    for nod in _keep_spaced(large, _beats(annotation, style, rng), MIN_BEAT_DISTANCE_S):
        down = nod.down_s / style.head_tempo
        depth = float(np.radians(nod.depth_deg) * style.head_scale**0.7)
        up, rise = float(down * rng.uniform(1.0, 1.5)), float(depth * rng.uniform(0.85, 1.1))
        moves.append(HeadMovement(nod.apex_s - down, down, (depth, 0.0, 0.0)))
        moves.append(HeadMovement(nod.apex_s, up, (-rise, 0.0, 0.0)))
    return moves


def _nods(annotation: Annotation, style: SpeakerStyle, rng: np.random.Generator) -> list[Nod]:
    tie = 0.4 + 0.6 * style.speech_coupling
    found = []
    for phoneme in annotation.phonemes:
        chance = (
            2.0 * style.nod_probability * tie * _emphasis(phoneme) if phoneme.stressed else UNSTRESSED_NOD_PROBABILITY
        )
        if rng.random() < chance:
            found.append(_make_nod(phoneme, _depth_deg(NOD_DEG, rng), NOD_S, rng))
    for span in annotation.speaking:
        if rng.random() < FINAL_NOD_PROBABILITY:
            apex = span.end_s + rng.uniform(-0.35, -0.05)
            found.append(Nod(apex, _depth_deg(FINAL_NOD_DEG, rng), rng.uniform(*NOD_S)))
    return found


def _beats(annotation: Annotation, style: SpeakerStyle, rng: np.random.Generator) -> list[Nod]:
    """Small strokes on stressed syllables (Hadar 1984), with depth increasing with prominence."""
    tie = 0.4 + 0.6 * style.speech_coupling
    found = []
    for phoneme in annotation.phonemes:
        if phoneme.stressed:
            beat = _make_nod(phoneme, rng.uniform(*BEAT_DEG), BEAT_S, rng)
            found.append(replace(beat, depth_deg=beat.depth_deg * tie * (0.2 + 1.4 * _emphasis(phoneme))))
    return found


def _emphasis(phoneme: Phoneme) -> float:
    """Prominence of a stressed syllable; the default where it was not measured."""
    return phoneme.prominence or DEFAULT_PROMINENCE


def _depth_deg(median_deg: float, rng: np.random.Generator) -> float:
    return float(median_deg * min(rng.lognormal(0.0, DEPTH_SPREAD), MAX_DEPTH_FACTOR))


def _make_nod(phoneme: Phoneme, depth_deg: float, down_s: tuple[float, float], rng: np.random.Generator) -> Nod:
    apex = (phoneme.start_s + phoneme.end_s) / 2 + NOD_SLACK_S * rng.standard_normal()
    return Nod(float(apex), float(depth_deg), float(rng.uniform(*down_s)))


def _keep_spaced(kept: list[Nod], more: list[Nod], min_distance_s: float) -> list[Nod]:
    """Add to `kept` the nods of `more` that are far enough from those already included, in order of time."""
    found = list(kept)
    for nod in sorted(more, key=_apex_s):
        place = bisect(found, nod.apex_s, key=_apex_s)
        if all(abs(nod.apex_s - each.apex_s) >= min_distance_s for each in found[max(0, place - 1) : place + 1]):
            found.insert(place, nod)
    return found


def _apex_s(nod: Nod) -> float:
    return nod.apex_s


def loudness_pitch(annotation: Annotation, style: SpeakerStyle, rng: np.random.Generator) -> list[HeadMovement]:
    """Head pitch that follows word loudness, lower on loud words (Munhall et al. 2004), with a gain per take."""
    slope = float(np.radians(LEAN_DEG) * style.speech_coupling * style.head_scale * max(0.0, rng.normal(1.0, 0.5)))
    moves: list[HeadMovement] = []
    pose = 0.0
    loudness = [_loudness(word, annotation.phonemes) for word in annotation.words]
    for word, loud in zip(annotation.words, loudness, strict=True):
        target = slope * float(np.clip(loud - np.mean(loudness), -1.0, 1.0))
        onset = word.start_s + LEAN_AFTER_S + LEAN_SLACK_S * rng.standard_normal()
        moves.append(HeadMovement(float(onset), LEAN_S / style.head_tempo, (target - pose, 0.0, 0.0)))
        pose = target
    return moves


def _loudness(word: Span, phonemes: Sequence[Phoneme]) -> float:
    inside = [each.loudness for each in phonemes if word.start_s <= each.start_s < word.end_s]
    return float(np.mean(inside)) if inside else 0.0


def listener_nods(annotation: Annotation, style: SpeakerStyle, rng: np.random.Generator) -> list[HeadMovement]:
    """Nods of a listener around the ends of the partner's phrases, with decreasing depth and a rhythm of their own."""
    moves: list[HeadMovement] = []
    for span in annotation.partner:
        onset = span.end_s + rng.uniform(*BACKCHANNEL_LATENCY_S)
        if rng.random() > BACKCHANNEL_PROBABILITY or (moves and onset < moves[-1].onset_s + moves[-1].duration_s):
            continue
        cycles = min(int(rng.geometric(SINGLE_PROBABILITY)), MAX_CYCLES)
        depth = float(np.radians(_depth_deg(BACKCHANNEL_DEG, rng)) * style.head_scale**0.7)
        stroke_s = (SINGLE_STROKE_S if cycles == 1 else REPEATED_STROKE_S) * rng.lognormal(0.0, STROKE_SPREAD)
        for _ in range(cycles):
            down, up = (float(stroke_s * rng.uniform(0.9, 1.1) / style.head_tempo) for _ in range(2))
            moves.append(HeadMovement(float(onset), down, (depth, 0.0, 0.0)))
            moves.append(HeadMovement(float(onset + down), up, (-depth, 0.0, 0.0)))
            onset, depth = onset + down + up, depth * rng.uniform(0.5, 0.9)
    return moves


def head_sway(style: SpeakerStyle, rng: np.random.Generator) -> Sinusoids:
    """Slow sway of the head's joint: a few millimetres, largest in depth."""
    frequency = rng.uniform(0.05, 0.5, 5)
    amplitude = style.translation_scale * np.array([0.003, 0.0015, 0.004]) * rng.rayleigh(0.6, (5, 3))
    return Sinusoids(frequency, amplitude, rng.uniform(0.0, 2.0 * np.pi, (5, 3)))


def _triple(rotation_vector: Float[ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in rotation_vector)
    return x, y, z
