"""Effects of emotion on head, gaze and blinks: factors on the style of a speaker at full intensity, in one table.

Directions are those of the sources, sizes are choices of this project [U]: as large as differences between speakers, or
larger, so that people see them (viewers told emotions apart by the head alone: Livingstone & Palmer 2016).

Head: range, speed and activation rise in anger and happiness and fall in sadness (Busso et al. 2007, IEEE TASLP 15(3)).
In sadness it is lowered, in happiness raised (Livingstone & Palmer 2016, Emotion 16(3)), in contempt raised (Ekman &
Friesen 1986, Motiv Emot 10(2)). In anger it is lowered, so that the eyes look from below the brows, in fear and disgust
drawn back [U].
Gaze: anger and joy go with gaze at the partner, fear and sadness with gaze away (Adams & Kleck 2005, Emotion 5(1));
averted in disgust and contempt [U]. Fear moves the eyes faster over a wider field, disgust the opposite (Susskind et
al. 2008, Nat Neurosci 11(7)). In sadness gaze away is down (Lance & Marsella 2010, IEEE CG&A 30(4)) and slow [U]; in
anger and surprise it holds the partner for longer [U].
Blinks: most in fear, fewer in sadness (Maffei & Angrilli 2019, Physiol Behav 204, of viewers of films); fewer in
surprise and anger, which stare [U].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from talkingeyes.physiology.gaze_population import GazeHabits
from talkingeyes.synthesis.speakers import SpeakerStyle


@dataclass(frozen=True)
class EmotionFactors:
    """Factors on head range, head speed, nods, odds of gaze aversion, rate of gaze shifts, distance of averted places
    and blinks; lowering of the head and of averted places in degrees."""

    head_range: float = 1.0
    head_tempo: float = 1.0
    nods: float = 1.0
    aversion_odds: float = 1.0
    gaze_rate: float = 1.0
    gaze_range: float = 1.0
    blinks: float = 1.0
    head_down_deg: float = 0.0
    gaze_down_deg: float = 0.0


EMOTION_FACTORS: dict[str, EmotionFactors] = {
    "neutral": EmotionFactors(),
    "happy": EmotionFactors(
        head_range=1.35, head_tempo=1.2, nods=1.3, aversion_odds=0.75, blinks=1.05, head_down_deg=-3.0
    ),
    "sad": EmotionFactors(
        head_range=0.6,
        head_tempo=0.7,
        nods=0.6,
        aversion_odds=2.0,
        gaze_rate=0.7,
        gaze_range=0.85,
        blinks=0.85,
        head_down_deg=8.0,
        gaze_down_deg=6.0,
    ),
    "surprised": EmotionFactors(
        head_range=1.15, head_tempo=1.2, nods=0.8, aversion_odds=0.6, gaze_rate=0.8, blinks=0.75, head_down_deg=-4.0
    ),
    "fear": EmotionFactors(
        head_range=0.8,
        head_tempo=1.4,
        nods=0.6,
        aversion_odds=1.6,
        gaze_rate=1.5,
        gaze_range=1.35,
        blinks=1.3,
        head_down_deg=-2.0,
    ),
    "disgusted": EmotionFactors(
        head_tempo=0.9, nods=0.8, aversion_odds=1.8, gaze_rate=0.85, gaze_range=0.85, blinks=1.1, head_down_deg=-3.0
    ),
    "angry": EmotionFactors(
        head_range=1.5,
        head_tempo=1.3,
        nods=1.6,
        aversion_odds=0.4,
        gaze_rate=0.65,
        gaze_range=0.85,
        blinks=0.8,
        head_down_deg=4.0,
    ),
    "contempt": EmotionFactors(
        head_range=0.85, head_tempo=0.85, nods=0.7, aversion_odds=1.5, gaze_rate=0.85, head_down_deg=-7.0
    ),
}


def emotional_style(style: SpeakerStyle, emotion: str, strength: float) -> SpeakerStyle:
    """Apply an emotion to a style; `strength` is 0 for no effect and 1 for the full effect."""
    affect = EMOTION_FACTORS[emotion]
    gaze_range, gaze_down_deg = affect.gaze_range**strength, strength * affect.gaze_down_deg

    def scaled(factor: float) -> float:
        return float(factor**strength)

    return replace(
        style,
        partner_gaze_speaking=_scaled_odds(style.partner_gaze_speaking, scaled(affect.aversion_odds)),
        partner_gaze_listening=_scaled_odds(style.partner_gaze_listening, scaled(affect.aversion_odds)),
        liveliness=style.liveliness * scaled(affect.gaze_rate),
        aversion_scale=style.aversion_scale * gaze_range,
        aversion_lowering=style.aversion_lowering + float(np.radians(gaze_down_deg)),
        habits=style.habits and _emotional_habits(style.habits, gaze_range, gaze_down_deg),
        head_scale=style.head_scale * scaled(affect.head_range),
        head_tempo=style.head_tempo * scaled(affect.head_tempo),
        nod_probability=style.nod_probability * scaled(affect.nods),
        blinks_per_min=style.blinks_per_min * scaled(affect.blinks),
        rest_pitch=style.rest_pitch + strength * float(np.radians(affect.head_down_deg)),
    )


def _emotional_habits(habits: GazeHabits, gaze_range: float, gaze_down_deg: float) -> GazeHabits:
    """Habits with averted places further from the partner, and lower."""
    states = {
        state: replace(how, away_places_deg=how.away_places_deg * gaze_range - np.array([0.0, gaze_down_deg]))
        for state, how in habits.states.items()
    }
    return replace(habits, states=states)


def _scaled_odds(probability: float, factor: float) -> float:
    """Proportion of gaze at the partner after the odds of looking away are multiplied by `factor`."""
    return probability / (probability + factor * (1.0 - probability))
