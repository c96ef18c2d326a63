"""Jaw from phonemes by dominance functions (Cohen & Massaro 1993).

F(t) = sum D_s T_s / sum D_s with D_s = alpha_s exp(-theta |t - t_s|): every phoneme pulls the jaw towards its own
target, the more so the nearer it is. Phonemes are espeak-ng mnemonics; targets are jaw rotations in radians (FACTS,
section 6). A constant weak pull towards the closed jaw makes it rest in silence.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Phoneme

THETA_PER_S = 25.0
REST_DOMINANCE = 0.06
STRESS_GAIN, UNSTRESSED_GAIN = 1.2, 0.9
JAW_LIMIT_RAD = 0.30

# Jaw target (radians) and dominance by the first letters of a mnemonic; the longest match counts.
_TARGETS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("p", "b", "m"), (0.0, 1.0)),
    **dict.fromkeys(("f", "v"), (0.01, 1.0)),
    **dict.fromkeys(("s", "z", "S", "Z", "tS", "dZ"), (0.01, 0.9)),
    **dict.fromkeys(("t", "d", "n", "T", "D"), (0.03, 0.6)),
    **dict.fromkeys(("l", "r", "R"), (0.06, 0.4)),
    **dict.fromkeys(("k", "g", "N", "x", "h", "?"), (0.06, 0.3)),
    **dict.fromkeys(("w", "j"), (0.04, 0.5)),
    "@": (0.05, 0.3),
    "3": (0.07, 0.7),
    "I": (0.06, 0.8),
    "i": (0.05, 0.8),
    "U": (0.06, 0.8),
    "u": (0.05, 0.8),
    "y": (0.05, 0.8),
    "e": (0.11, 0.9),
    "E": (0.13, 0.9),
    "o": (0.11, 0.9),
    "O": (0.14, 0.9),
    "0": (0.17, 1.0),
    "V": (0.15, 0.9),
    "a": (0.19, 1.0),
    "A": (0.21, 1.0),
    "&": (0.16, 1.0),
}
_OTHER = (0.05, 0.3)
VOWELS = frozenset("@3IiUuyeEoO0VaA&")


def jaw_opening(phonemes: Sequence[Phoneme], times_s: Float[ndarray, " T"], scale: float = 1.0) -> Float[ndarray, " T"]:
    """Jaw rotation about x (positive opens), radians."""
    if not phonemes:
        return np.zeros(len(times_s))
    middle, target, strength = np.array([_pull(phoneme) for phoneme in phonemes]).T
    dominance = strength * np.exp(-THETA_PER_S * np.abs(times_s[:, None] - middle))
    opening = (dominance @ target) / (dominance.sum(axis=1) + REST_DOMINANCE)
    return np.asarray(np.clip(scale * opening, 0.0, JAW_LIMIT_RAD))


def _pull(phoneme: Phoneme) -> tuple[float, float, float]:
    target, strength = target_of(phoneme.symbol)
    if phoneme.symbol[:1] in VOWELS:
        target *= STRESS_GAIN if phoneme.stressed else UNSTRESSED_GAIN
    return (phoneme.start_s + phoneme.end_s) / 2, target, strength


def target_of(symbol: str) -> tuple[float, float]:
    """Jaw target (radians) and dominance of a phoneme mnemonic."""
    for length in range(len(symbol), 0, -1):
        if symbol[:length] in _TARGETS:
            return _TARGETS[symbol[:length]]
    return _OTHER
