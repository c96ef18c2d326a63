"""Speakers: a voice and a style, sampled per person and constant over all clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.head.eyelid.anatomy import EyelidParameters
from talkingeyes.physiology.blinks import PHYSIOLOGICAL, BlinkProfile, sample_blink_rate
from talkingeyes.physiology.contact_population import SHARES, ContactPopulation, contact_habits, read_contact
from talkingeyes.physiology.gaze_population import GazeHabits, read_population, sample_habits
from talkingeyes.physiology.lids import sample_eyelids
from talkingeyes.synthesis.voice_profiles import Voice, sample_voice

BLINK_COMPLETENESS = (7.0, 3.0)  # Beta: mean 0.7; full closure in half to three quarters of blinks (Sforza 2008)
KAPPA_DEG, KAPPA_EYE_DEG, KAPPA_DOWN_DEG = (4.5, 1.2), 0.4, (1.0, 0.7)  # typically 5 temporal, 1 to 2 vertical
IDENTITY_SHAPES = 6


@dataclass(frozen=True)
class SpeakerStyle:
    """Movement style of one person. Angles are in radians; scales are factors around 1.

    `partner_gaze_speaking` is the proportion of talking time with gaze at the partner, `partner_gaze_listening` that of
    listening time. `aversion_side` is the preferred side of aversions (yaw), `aversion_lowering` how far below their
    usual places they are. `liveliness` scales rate and amplitude of
    gaze shifts (1 as in an interview, less for a calm source). `speech_coupling` (0 to 1) is the influence of speech on
    gaze and head. `head_tempo` scales the speed of the head, `head_axes` its rotation per axis (pitch, yaw, roll) and
    `translation_scale` its translation. `head_threshold` and `head_gain` are the eccentricity from which the head
    contributes to gaze shifts, and its gain. `speaking_lift` is the rise of the head while speaking,
    `blink_completeness` the proportion of blinks that close the lids, `kappa` the (yaw, pitch) from the visual to the
    optical axis of the left and the right eye. `dwell_scale` is a factor on the duration of looks at the partner and
    away, whose distributions are those of `contact`. `habits` are fixations of a recorded population; None: looks as
    recorded face to face (gaze_aversion), scanned as in the literature (gaze_shifts). `cue_delay_s` delays all cues
    that speech gives to gaze.
    """

    partner_gaze_speaking: float
    partner_gaze_listening: float
    liveliness: float
    aversion_side: float
    aversion_scale: float
    saccade_rate: float
    speech_coupling: float
    head_scale: float
    head_axes: tuple[float, float, float]
    translation_scale: float
    head_tempo: float
    head_threshold: float
    head_gain: float
    nod_probability: float
    speaking_lift: float
    blinks_per_min: float
    blink_completeness: float
    rest_pitch: float
    rest_roll: float
    lid_rest: float
    jaw_scale: float
    jaw_asymmetry: float
    lip_scale: float
    expressiveness: float
    eyelids: tuple[EyelidParameters, EyelidParameters]
    kappa: tuple[tuple[float, float], tuple[float, float]]
    dwell_scale: float
    contact: ContactPopulation
    habits: GazeHabits | None = None
    cue_delay_s: float = 0.0
    aversion_lowering: float = 0.0


@dataclass(frozen=True)
class Speaker:
    """A synthetic speaker. `identity`: standard normal numbers that determine the head shape."""

    name: str
    voice: Voice
    style: SpeakerStyle
    identity: tuple[float, ...]


def sample_style(
    rng: np.random.Generator, blinks: BlinkProfile = PHYSIOLOGICAL, liveliness: float = 1.0
) -> SpeakerStyle:
    """Sample a style from the distributions over people; `blinks` is the profile of blink rates."""
    population = read_contact("face_to_face")
    person = contact_habits(population, rng.standard_normal(3))
    return SpeakerStyle(
        contact=population,
        partner_gaze_speaking=person.share_speaking,
        partner_gaze_listening=person.share_listening,
        dwell_scale=person.dwell_scale,
        liveliness=liveliness,
        aversion_side=float(rng.normal(0.0, 0.25)),
        aversion_scale=float(np.exp(0.25 * rng.standard_normal())),
        saccade_rate=float(np.exp(0.20 * rng.standard_normal())),
        speech_coupling=float(rng.beta(5.0, 2.0)),
        head_scale=float(np.clip(np.exp(0.30 * rng.standard_normal()), 0.45, 1.9)),
        head_axes=(1.0, 1.0, 1.0),
        translation_scale=1.0,
        head_tempo=1.0,
        head_threshold=float(np.radians(rng.uniform(5.0, 15.0))),
        head_gain=float(rng.uniform(0.3, 0.9)),
        nod_probability=float(rng.uniform(0.07, 0.17)),
        speaking_lift=float(np.radians(rng.normal(3.8, 1.2))),
        blinks_per_min=sample_blink_rate(blinks, rng),
        rest_pitch=float(np.radians(rng.normal(2.0, 2.5))),
        rest_roll=float(np.radians(rng.normal(0.0, 1.5))),
        lid_rest=float(np.clip(rng.normal(0.0, 0.04), -0.1, 0.12)),
        jaw_scale=float(np.exp(0.15 * rng.standard_normal())),
        jaw_asymmetry=float(rng.normal(0.0, 0.12)),
        lip_scale=float(np.exp(0.12 * rng.standard_normal())),
        expressiveness=float(np.exp(0.2 * rng.standard_normal())),
        eyelids=sample_eyelids(rng),
        blink_completeness=float(rng.beta(*BLINK_COMPLETENESS)),
        kappa=_kappa(rng),
    )


def _kappa(rng: np.random.Generator) -> tuple[tuple[float, float], tuple[float, float]]:
    """The optical axis points temporally of the visual axis, mirrored between the eyes, and slightly down."""
    temporal = np.radians(rng.normal(*KAPPA_DEG) + KAPPA_EYE_DEG * rng.standard_normal(2))
    down = np.radians(rng.normal(*KAPPA_DOWN_DEG, size=2))
    return (float(temporal[0]), float(-down[0])), (float(-temporal[1]), float(-down[1]))


def sample_speaker(
    name: str,
    language: str,
    rng: np.random.Generator,
    blinks: BlinkProfile = PHYSIOLOGICAL,
    liveliness: float = 1.0,
    voices: Sequence[str] = (),
) -> Speaker:
    """Sample a speaker of `language`, with one of `voices` if given."""
    voice, style = sample_voice(rng, language, voices), sample_style(rng, blinks, liveliness)
    return Speaker(name, voice, style, tuple(map(float, rng.standard_normal(IDENTITY_SHAPES))))


def with_contact(style: SpeakerStyle, population: ContactPopulation, normal: Float[ndarray, " 3"]) -> SpeakerStyle:
    """The style with the looks of the person of a population that three standard normal numbers stand for."""
    person = contact_habits(population, normal)
    return replace(
        style,
        contact=population,
        partner_gaze_speaking=person.share_speaking,
        partner_gaze_listening=person.share_listening,
        dwell_scale=person.dwell_scale,
    )


def with_habits(style: SpeakerStyle, population: str, rng: np.random.Generator) -> SpeakerStyle:
    """The style with the gaze of a person sampled from a recorded population (physiology/populations)."""
    habits = sample_habits(read_population(population), rng)
    speaking, listening = (habits.states[state].partner_share for state in ("speaking", "listening"))
    return replace(
        style,
        habits=habits,
        partner_gaze_speaking=float(np.clip(speaking, *SHARES)),
        partner_gaze_listening=float(np.clip(listening, *SHARES)),
    )
