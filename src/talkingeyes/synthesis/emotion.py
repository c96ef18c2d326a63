"""Effects of emotion on head, eyes and lids: factors on the style of a speaker at full intensity, in one table.

Head: range, speed and activation rise in anger and happiness and fall in sadness (Busso et al. 2007, IEEE TASLP 15(3)).
Gaze: anger and joy increase gaze at the partner, fear and sadness decrease it (Adams & Kleck 2005, Emotion 5(1));
disgust and contempt avert it; in sadness the head is lowered, in contempt the chin is raised (Ekman & Friesen 1986).
Blinks rise with arousal and fall in sadness (Maffei & Angrilli 2019, Int J Psychophysiol). The directions of the
effects are those of the sources. The sizes are choices of this project and small, so that differences between speakers
exceed those between emotions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from talkingeyes.synthesis.speakers import SpeakerStyle


@dataclass(frozen=True)
class EmotionFactors:
    """Factors on head range, head speed, nods, odds of gaze aversion and blinks; lowering of the head in degrees."""

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
    """Apply an emotion to a style; `strength` is 0 for no effect and 1 for the full effect."""
    affect = EMOTION_FACTORS[emotion]

    def scaled(factor: float) -> float:
        return float(factor**strength)

    return replace(
        style,
        partner_gaze_speaking=_scaled_odds(style.partner_gaze_speaking, scaled(affect.aversion_odds)),
        partner_gaze_listening=_scaled_odds(style.partner_gaze_listening, scaled(affect.aversion_odds)),
        head_scale=style.head_scale * scaled(affect.head_range),
        head_tempo=style.head_tempo * scaled(affect.head_tempo),
        nod_probability=style.nod_probability * scaled(affect.nods),
        blinks_per_min=style.blinks_per_min * scaled(affect.blinks),
        rest_pitch=style.rest_pitch + strength * float(np.radians(affect.head_down_deg)),
    )


def _scaled_odds(probability: float, factor: float) -> float:
    """Proportion of gaze at the partner after the odds of looking away are multiplied by `factor`."""
    return probability / (probability + factor * (1.0 - probability))
