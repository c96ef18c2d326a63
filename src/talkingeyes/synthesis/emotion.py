"""How emotions move head, eyes and lids: factors on a person's style at full strength, in one table.

Head: range, speed and activation rise in anger and happiness and fall in sadness (Busso et al. 2007, IEEE TASLP 15(3)).
Gaze: anger and joy look at the partner, fear and sadness away (Adams & Kleck 2005, Emotion 5(1)); disgust and contempt
turn away; sadness sinks the head, contempt lifts the chin (Ekman & Friesen 1986). Blinks rise with arousal and fall in
sadness (Maffei & Angrilli 2019, Int J Psychophysiol). The directions are those of the sources; the sizes are choices of
this project, kept small, so that people still differ more than their moods.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from talkingeyes.synthesis.speakers import SpeakerStyle


@dataclass(frozen=True)
class EmotionFactors:
    """Factors of head range, head speed, nods, odds of looking away and blinks; how far the head hangs, degrees."""

    head_range: float = 1.0
    head_tempo: float = 1.0
    nods: float = 1.0
    aversion_odds: float = 1.0
    blinks: float = 1.0
    head_down_deg: float = 0.0


EMOTION_FACTORS: dict[str, EmotionFactors] = {
    "neutral": EmotionFactors(),
    "happy": EmotionFactors(
        head_range=1.25, head_tempo=1.10, nods=1.2, aversion_odds=0.85, blinks=1.05, head_down_deg=-1.0
    ),
    "sad": EmotionFactors(
        head_range=0.75, head_tempo=0.85, nods=0.7, aversion_odds=1.50, blinks=0.90, head_down_deg=5.0
    ),
    "surprised": EmotionFactors(
        head_range=1.15, head_tempo=1.15, nods=0.9, aversion_odds=0.80, blinks=0.85, head_down_deg=-2.0
    ),
    "fear": EmotionFactors(
        head_range=0.90, head_tempo=1.15, nods=0.8, aversion_odds=1.35, blinks=1.25, head_down_deg=-1.0
    ),
    "disgusted": EmotionFactors(
        head_range=1.05, head_tempo=0.95, nods=0.9, aversion_odds=1.30, blinks=1.10, head_down_deg=-1.5
    ),
    "angry": EmotionFactors(
        head_range=1.30, head_tempo=1.15, nods=1.3, aversion_odds=0.70, blinks=1.05, head_down_deg=2.0
    ),
    "contempt": EmotionFactors(head_range=0.95, head_tempo=0.95, nods=0.8, aversion_odds=1.20, head_down_deg=-3.0),
}


def emotional_style(style: SpeakerStyle, emotion: str, strength: float) -> SpeakerStyle:
    """The style of somebody in an emotion; `strength` is how much of it shows (0 nothing, 1 its full strength)."""
    affect = EMOTION_FACTORS[emotion]

    def scaled(factor: float) -> float:
        return float(factor**strength)

    return replace(
        style,
        look=_scaled_odds(style.look, scaled(affect.aversion_odds)),
        partner_gaze_listening=_scaled_odds(style.partner_gaze_listening, scaled(affect.aversion_odds)),
        head_scale=style.head_scale * scaled(affect.head_range),
        head_tempo=style.head_tempo * scaled(affect.head_tempo),
        nod_probability=style.nod_probability * scaled(affect.nods),
        blinks_per_min=style.blinks_per_min * scaled(affect.blinks),
        rest_pitch=style.rest_pitch + strength * float(np.radians(affect.head_down_deg)),
    )


def _scaled_odds(look: float, factor: float) -> float:
    """The share of looking when the odds of looking away are so many times as high."""
    return look / (look + factor * (1.0 - look))
