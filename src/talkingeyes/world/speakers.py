"""Who speaks: a voice and a style. Styles are drawn per person and stay the same in all clips (FACTS, section 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from talkingeyes.physiology.blinks import PHYSIO, BlinkProfile, draw_rate_per_min
from talkingeyes.world.voices import Voice, draw_voice


@dataclass(frozen=True)
class Style:
    """How one person moves. Angles in radians; scales are factors about 1.

    `look` is the share of talking time spent looking at the partner, `side` the preferred side of looking away (yaw),
    `coupling` (0 to 1) how far what is said moves gaze and head at all, `head_threshold` and `head_gain` the
    eccentricity from which, and the share with which, the head goes along with gaze, `speaking_lift` how far speech
    raises the head.
    """

    look: float
    side: float
    aversion_scale: float
    saccade_rate: float
    coupling: float
    head_scale: float
    head_threshold: float
    head_gain: float
    nod_probability: float
    speaking_lift: float
    blinks_per_min: float
    rest_pitch: float
    rest_roll: float
    lid_rest: float
    jaw_scale: float
    jaw_asymmetry: float


@dataclass(frozen=True)
class Speaker:
    """A person of the synthetic world."""

    name: str
    voice: Voice
    style: Style


def draw_style(random: np.random.Generator, blinks: BlinkProfile = PHYSIO) -> Style:
    """A style from the distributions over people; `blinks` is the profile of blink rates."""
    return Style(
        look=float(np.clip(random.beta(4.0, 3.3), 0.2, 0.9)),
        side=float(random.normal(0.0, 0.25)),
        aversion_scale=float(0.88 * np.exp(0.25 * random.standard_normal())),
        saccade_rate=float(np.exp(0.20 * random.standard_normal())),
        coupling=float(random.beta(5.0, 2.0)),
        head_scale=float(np.clip(np.exp(0.30 * random.standard_normal()), 0.45, 1.9)),
        head_threshold=float(np.radians(random.uniform(5.0, 15.0))),
        head_gain=float(random.uniform(0.3, 0.9)),
        nod_probability=float(random.uniform(0.2, 0.4)),
        speaking_lift=float(np.radians(random.normal(2.8, 1.2))),
        blinks_per_min=draw_rate_per_min(blinks, random),
        rest_pitch=float(np.radians(random.normal(2.0, 2.5))),
        rest_roll=float(np.radians(random.normal(0.0, 1.5))),
        lid_rest=float(np.clip(random.normal(0.0, 0.04), -0.1, 0.12)),
        jaw_scale=float(np.exp(0.15 * random.standard_normal())),
        jaw_asymmetry=float(random.normal(0.0, 0.12)),
    )


def draw_speaker(name: str, language: str, random: np.random.Generator, blinks: BlinkProfile = PHYSIO) -> Speaker:
    """A person who speaks `language`."""
    return Speaker(name, draw_voice(random, language), draw_style(random, blinks))
