"""Jaw and lips from phonemes by dominance functions (Cohen & Massaro 1993), with separate jaw and lip fields (JALI).

F_p(t) = sum_s D_sp T_sp / sum_s D_sp with D_sp = alpha_sp exp(-theta_p |t - t_s|): every phoneme s has a target for
each field p (jaw, rounding, spreading, parting), with a weight that decays with distance in time, which models
coarticulation. Lips close for p, b, m and meet the teeth for f, v regardless of context; rounding starts earliest
(Edwards et al. 2016). Phonemes are espeak-ng mnemonics, jaw targets are in radians, the others 0 to 1. A weak resting
target closes the mouth in silence. Everything is a function of time, for any frame rate. Each time is computed from its
nearest phonemes only (others have weights below 1e-4), so cost is linear in duration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.audio.annotation import Phoneme
from talkingeyes.head.anny_build import JAW_OPEN_RAD

# Growth rate of a phoneme's weight before it, and decay rate after it, for jaw, rounding, spreading and parting.
THETA_BEFORE_PER_S = np.array([25.0, 12.0, 15.0, 18.0])
THETA_AFTER_PER_S = np.array([25.0, 15.0, 17.0, 20.0])
REST_DOMINANCE = np.array([0.06, 0.10, 0.10, 0.10])
NEAREST_PHONEMES = 17  # number of phonemes that contribute to each time
UNDERSHOOT_GAIN = 1.2  # of vowels: compensates the undershoot of the jaw between consonants
LOUDNESS_EXPONENT, LOUDNESS_GAIN = 0.3, (0.6, 1.45)
JAW_LIMIT_RAD = 0.30
APEX = 0.45  # position of the target within a phoneme; below, of the two parts of a diphthong
DIPHTHONG_APEX = (0.3, 0.8)
LIP_CONTACT_RAMP_S = 0.055  # time in which lips close and part
CONTACT_S, CONTACT_SHARE = 0.045, 0.5  # minimum duration of contact, as a time and as a fraction of the phoneme

# Jaw (radians) and its dominance; rounding, spreading and parting of the lips, and their dominance. Keys are prefixes
# of mnemonics; the longest match applies.
_TARGETS: dict[str, tuple[float, float, float, float, float, float]] = {
    **dict.fromkeys(("p", "b", "m"), (0.0, 1.2, 0.0, 0.0, 0.0, 0.15)),
    **dict.fromkeys(("f", "v"), (0.01, 1.2, 0.0, 0.1, 0.1, 0.4)),
    **dict.fromkeys(("s", "z", "ts"), (0.01, 1.2, 0.0, 0.35, 0.5, 0.5)),
    **dict.fromkeys(("S", "Z", "tS", "dZ"), (0.01, 1.2, 0.55, 0.0, 0.5, 0.8)),
    **dict.fromkeys(("t", "d", "n", "T", "D"), (0.02, 0.9, 0.0, 0.1, 0.15, 0.15)),
    **dict.fromkeys(("l", "R", "Q", "*"), (0.04, 0.6, 0.0, 0.1, 0.1, 0.15)),
    **dict.fromkeys(("k", "g", "N", "x", "X", "C", "h", "H", "?"), (0.04, 0.45, 0.0, 0.1, 0.1, 0.1)),
    "r": (0.04, 0.6, 0.3, 0.0, 0.1, 0.5),
    "w": (0.03, 0.75, 1.0, 0.0, 0.0, 1.0),
    "j": (0.03, 0.75, 0.0, 0.5, 0.2, 0.5),
    "@": (0.05, 0.3, 0.0, 0.1, 0.1, 0.3),
    "3": (0.07, 0.7, 0.2, 0.0, 0.1, 0.6),
    "I": (0.06, 0.8, 0.0, 0.5, 0.25, 0.9),
    "i": (0.05, 0.8, 0.0, 0.9, 0.35, 1.0),
    "U": (0.06, 0.8, 0.7, 0.0, 0.0, 1.0),
    "u": (0.05, 0.8, 1.0, 0.0, 0.0, 1.0),
    "y": (0.05, 0.8, 1.0, 0.0, 0.0, 1.0),
    "Y": (0.08, 0.9, 0.85, 0.0, 0.0, 1.0),
    "W": (0.12, 0.9, 0.7, 0.0, 0.1, 1.0),
    "e": (0.11, 0.9, 0.0, 0.6, 0.3, 1.0),
    "E": (0.13, 0.9, 0.0, 0.45, 0.25, 1.0),
    "o": (0.11, 0.9, 0.8, 0.0, 0.0, 1.0),
    "O": (0.14, 0.9, 0.65, 0.0, 0.0, 1.0),
    "0": (0.17, 1.0, 0.35, 0.0, 0.1, 0.9),
    "V": (0.15, 0.9, 0.0, 0.15, 0.15, 0.8),
    "a": (0.19, 1.0, 0.0, 0.2, 0.2, 0.8),
    "A": (0.21, 1.0, 0.1, 0.0, 0.1, 0.8),
    "&": (0.16, 1.0, 0.0, 0.4, 0.3, 0.9),
}
_OTHER = (0.05, 0.3, 0.0, 0.1, 0.1, 0.2)
VOWELS = frozenset("@3IiUuyYWeEoO0VaA&")
BILABIALS = ("p", "b", "m")
LABIODENTALS = ("f", "v")

# Effect of the fields on the lips of a head with ARKit's shapes (a name without a side stands for both sides). Funnel
# scales with jaw opening, because it parts the lips.
ROUND = {"mouthPucker": 0.8}
ROUND_OPEN = {"mouthFunnel": 0.35}
SPREAD = {"mouthStretch": 0.22, "mouthSmile": 0.14, "mouthDimple": 0.10}
PART = {"mouthLowerDown": 0.45, "mouthUpperUp": 0.28}
PRESS = {"mouthPress": 0.25, "mouthRollLower": 0.15}
TUCK = {"mouthRollLower": 0.55, "mouthShrugLower": 0.18, "mouthUpperUp": 0.16}
LABIODENTAL_CLOSURE = 0.55  # as a fraction of the jaw opening
LATERAL_SHAPES = frozenset(
    ("mouthStretch", "mouthSmile", "mouthDimple", "mouthLowerDown", "mouthUpperUp", "mouthPress")
)


@dataclass(frozen=True)
class ArticulationStyle:
    """Articulation of one person: factors on jaw and lips around 1, sideways motion of the jaw as it opens.

    `jaw_rest_rad` is the jaw angle in silence: 0 except in some emotions.
    """

    jaw_scale: float = 1.0
    lip_scale: float = 1.0
    jaw_asymmetry: float = 0.0
    jaw_rest_rad: float = 0.0


@dataclass(frozen=True)
class MouthMotion:
    """The mouth at T times: jaw rotation (radians), weights of lip shapes by name, degree of lip closure."""

    jaw: Float[ndarray, "T 3"]
    shapes: dict[str, Float[ndarray, " T"]]
    closed: Float[ndarray, " T"]


def mouth_motion(phonemes: Sequence[Phoneme], times_s: Float[ndarray, " T"], style: ArticulationStyle) -> MouthMotion:
    """Jaw and lips at ascending times."""
    fields = coarticulated_parameters(phonemes, times_s, style)
    opening = np.clip(fields[:, 0], 0.0, JAW_LIMIT_RAD)
    rounding, spreading, parting = np.clip(style.lip_scale * fields[:, 1:], 0.0, 1.2).T
    closed, tucked = lip_contact(phonemes, times_s, BILABIALS), lip_contact(phonemes, times_s, LABIODENTALS)
    free = (1.0 - closed) * (1.0 - tucked)
    open_share = np.minimum(opening / 0.10, 1.3)
    shapes: dict[str, Float[ndarray, " T"]] = {}
    for weights, drive in (
        (ROUND, rounding),
        (ROUND_OPEN, rounding * open_share * free),
        (SPREAD, spreading),
        (PART, parting * free),
        (PRESS, closed),
        (TUCK, tucked),
        ({"mouthClose": 1.0 / JAW_OPEN_RAD}, opening * np.maximum(closed, LABIODENTAL_CLOSURE * tucked)),
    ):
        for name, weight in weights.items():
            for shape in (f"{name}Left", f"{name}Right") if name in LATERAL_SHAPES else (name,):
                shapes[shape] = shapes.get(shape, 0.0) + weight * drive
    jaw = np.stack([opening, style.jaw_asymmetry * opening, np.zeros_like(opening)], axis=-1)
    return MouthMotion(jaw, shapes, np.maximum(closed, tucked))


def coarticulated_parameters(
    phonemes: Sequence[Phoneme], times_s: Float[ndarray, " T"], style: ArticulationStyle
) -> Float[ndarray, "T 4"]:
    """Jaw in radians (scaled to the person); rounding, spreading and parting of the lips, 0 to 1."""
    rest = np.array([style.jaw_rest_rad, 0.0, 0.0, 0.0])
    if not phonemes:
        return np.tile(rest, (len(times_s), 1))
    targets_by_phoneme = np.array([pull for phoneme in phonemes for pull in _dominance_targets(phoneme)])
    middle_s, targets = targets_by_phoneme[:, 0], targets_by_phoneme[:, 1:5].copy()
    targets[:, 0] *= style.jaw_scale
    strength = targets_by_phoneme[:, [5, 6, 6, 6]]
    near = nearest_indices(middle_s, times_s, NEAREST_PHONEMES)
    after_s = (times_s[:, None] - middle_s[near])[..., None]
    dominance = strength[near] * np.exp(-np.where(after_s < 0, -THETA_BEFORE_PER_S, THETA_AFTER_PER_S) * after_s)
    pulled = (dominance * targets[near]).sum(axis=1) + REST_DOMINANCE * rest
    return np.asarray(pulled / (dominance.sum(axis=1) + REST_DOMINANCE))


def lip_contact(
    phonemes: Sequence[Phoneme], times_s: Float[ndarray, " T"], kinds: tuple[str, ...]
) -> Float[ndarray, " T"]:
    """Degree of lip contact (0 to 1) for phonemes of some kinds; complete for some time in each."""
    spans = np.array([(p.start_s, p.end_s) for p in phonemes if p.symbol.startswith(kinds)])
    if not len(spans):
        return np.zeros(len(times_s))
    middle_s = spans.mean(axis=1)
    half_s = np.maximum(CONTACT_SHARE * (spans[:, 1] - spans[:, 0]), CONTACT_S) / 2.0
    near = nearest_indices(middle_s, times_s, 4)
    away = (np.abs(times_s[:, None] - middle_s[near]) - half_s[near]) / LIP_CONTACT_RAMP_S
    left = 1.0 - np.clip(away, 0.0, 1.0)
    return np.asarray((left * left * (3.0 - 2.0 * left)).max(axis=1))


def nearest_indices(at_s: Float[ndarray, " N"], times_s: Float[ndarray, " T"], count: int) -> Int[ndarray, "T K"]:
    """Indices of the `count` elements around each time, or of all if there are fewer."""
    count = min(count, len(at_s))
    first = np.clip(np.searchsorted(at_s, times_s) - count // 2, 0, len(at_s) - count)
    return np.asarray(first[:, None] + np.arange(count))


def _dominance_targets(phoneme: Phoneme) -> Iterator[tuple[float, ...]]:
    """Time, targets and dominance: one entry per phoneme, two per diphthong."""
    gain = 1.0
    if phoneme.symbol[:1] in VOWELS:
        least, most = LOUDNESS_GAIN
        gain = UNDERSHOOT_GAIN * min(max(phoneme.loudness**LOUDNESS_EXPONENT, least), most)
    length_s = phoneme.end_s - phoneme.start_s
    second = next((letter for letter in phoneme.symbol[1:] if letter in VOWELS), "")
    parts = [phoneme.symbol, second] if second and phoneme.symbol[0] in VOWELS else [phoneme.symbol]
    for part, apex in zip(parts, DIPHTHONG_APEX if len(parts) == 2 else (APEX,), strict=True):
        jaw_rad, jaw_dominance, *lips, lip_dominance = phoneme_targets(part)
        yield (phoneme.start_s + apex * length_s, gain * jaw_rad, *lips, jaw_dominance, lip_dominance)


@cache
def phoneme_targets(symbol: str) -> tuple[float, float, float, float, float, float]:
    """A row of the table: jaw and its dominance; rounding, spreading, parting, and their dominance."""
    for length in range(len(symbol), 0, -1):
        if symbol[:length] in _TARGETS:
            return _TARGETS[symbol[:length]]
    return _OTHER
