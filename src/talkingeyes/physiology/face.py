"""Facial expression apart from eyes and speech: eight emotions, and brow raises, as shapes of the head.

Emotions are those of 3DMEAD (ProbTalk3D, section 3.1) at three intensities, as described by EMFACS (Ekman, Friesen &
Hager 2002), with action units translated to ARKit's shapes: happy 6+12+25, sad 1+4+15+17, surprised 1+2+5+26, fear
1+2+4+5+7+20+25, disgusted 9+10+15+6, angry 4+5+7+23+24, contempt 12+14 on one side. Unit 5, the raised upper lid, is a
negative `Motion.lid`; unit 26 is the rest angle of the jaw. Full intensity is as large as people's largest movements
where these were measured (docs/face.md, in millimetres), else a choice of this project. Strength fluctuates by a fifth.
Speech has priority at the mouth: what parts the lips is suppressed while they are closed, what presses them together
while they are closed or parted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.physiology.articulation import MouthMotion
from talkingeyes.physiology.eye_head import minimum_jerk


def _both(*names: str) -> tuple[str, ...]:
    return tuple(f"{name}{side}" for name in names for side in ("Left", "Right"))


# Expression shapes of a Motion of the open head: ARKit's 52 without gaze, blink and jaw (a test compares them).
FACE_SHAPES: tuple[str, ...] = tuple(
    sorted(
        (
            *_both("browDown", "browOuterUp", "cheekSquint", "eyeSquint", "eyeWide", "mouthDimple", "mouthFrown"),
            *_both("mouthLowerDown", "mouthPress", "mouthSmile", "mouthStretch", "mouthUpperUp", "noseSneer"),
            *("browInnerUp", "cheekPuff", "mouthClose", "mouthFunnel", "mouthLeft", "mouthPucker", "mouthRight"),
            *("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "tongueOut"),
        )
    )
)
LIP_PARTING_SHAPES = frozenset(_both("mouthUpperUp", "mouthLowerDown"))
LIP_PRESSING_SHAPES = frozenset((*_both("mouthPress"), "mouthRollLower", "mouthRollUpper", "mouthShrugLower"))
# Opening of the jaw, and weight of the lowered lower lip in speech, from which lips are not pressed.
PARTED_JAW_RAD, PARTED_LIP = 0.10, 0.08
INTENSITY_STRENGTH = (0.0, 0.4, 0.7, 1.0)
BROW_RAISE_SHAPES: Mapping[str, float] = {"browInnerUp": 0.8, "browOuterUpLeft": 1.0, "browOuterUpRight": 1.0}


@dataclass(frozen=True)
class EmotionExpression:
    """An emotion at full intensity.

    `shapes`: weights of face shapes. `lid`: closure added to the lids. `jaw_rest_rad`: rest angle of the jaw.
    `jaw_scale`: factor on jaw opening in speech.
    """

    shapes: Mapping[str, float]
    lid: float = 0.0
    jaw_rest_rad: float = 0.0
    jaw_scale: float = 1.0


def _expand_sides(**weights: float) -> Mapping[str, float]:
    """Weights by the names of FACE_SHAPES; a name without a side stands for both sides."""
    return {
        shape: weight
        for name, weight in weights.items()
        for shape in ((name,) if name in FACE_SHAPES else (f"{name}Left", f"{name}Right"))
    }


EMOTION_EXPRESSIONS: Mapping[str, EmotionExpression] = MappingProxyType(
    {
        "neutral": EmotionExpression({}),
        "happy": EmotionExpression(
            _expand_sides(
                cheekSquint=0.85, eyeSquint=0.5, mouthSmile=0.65, mouthDimple=0.3, mouthUpperUp=0.4, mouthLowerDown=0.2
            ),
            lid=0.05,
            jaw_rest_rad=0.02,
            jaw_scale=1.1,
        ),
        "sad": EmotionExpression(
            _expand_sides(browInnerUp=1.0, browDown=0.15, mouthFrown=0.8, mouthShrugLower=0.45),
            lid=0.18,
            jaw_scale=0.85,
        ),
        "surprised": EmotionExpression(
            _expand_sides(browInnerUp=1.0, browOuterUp=1.0), lid=-0.3, jaw_rest_rad=0.13, jaw_scale=1.15
        ),
        "fear": EmotionExpression(
            _expand_sides(
                browInnerUp=1.0, browOuterUp=0.4, browDown=0.35, eyeSquint=0.2, mouthStretch=0.85, mouthLowerDown=0.35
            ),
            lid=-0.32,
            jaw_rest_rad=0.04,
        ),
        "disgusted": EmotionExpression(
            _expand_sides(
                noseSneer=1.0, mouthUpperUp=0.7, mouthFrown=0.4, browDown=0.35, cheekSquint=0.5, eyeSquint=0.4
            ),
            lid=0.12,
            jaw_scale=0.95,
        ),
        "angry": EmotionExpression(
            _expand_sides(
                browDown=1.0, eyeSquint=0.6, noseSneer=0.25, mouthPress=0.6, mouthRollUpper=0.2, mouthRollLower=0.3
            ),
            lid=-0.15,
            jaw_scale=1.15,
        ),
        "contempt": EmotionExpression(
            _expand_sides(mouthSmileLeft=0.45, mouthDimpleLeft=0.8), lid=0.12, jaw_scale=0.95
        ),
    }
)


@dataclass(frozen=True)
class BrowRaise:
    """A raise of the brows with rise, hold and fall; `size` 1 is the maximum."""

    onset_s: float
    rise_s: float
    hold_s: float
    fall_s: float
    size: float

    @property
    def end_s(self) -> float:
        return self.onset_s + self.rise_s + self.hold_s + self.fall_s


@dataclass(frozen=True)
class FacialBehaviour:
    """Facial behaviour in a take apart from speech. `share` is the visible strength of the emotion (0 to 1)."""

    emotion: str = "neutral"
    share: float = 0.0
    brows: tuple[BrowRaise, ...] = ()

    @property
    def emotion_expression(self) -> EmotionExpression:
        """The emotion at full intensity."""
        return EMOTION_EXPRESSIONS[self.emotion]


def expression_weights(
    face: FacialBehaviour, mouth: MouthMotion, times_s: Float[ndarray, " T"], strength_over_time: Float[ndarray, " T"]
) -> Float[ndarray, "T C"]:
    """Weights of FACE_SHAPES, 0 to 1. `strength_over_time` is a factor on the emotion at each time, around 1."""
    weights = np.zeros((len(times_s), len(FACE_SHAPES)))
    brows = brow_height(face.brows, times_s)
    emotion_strength = face.share * strength_over_time
    free = 1.0 - mouth.closed
    parted = np.maximum(mouth.jaw[:, 0] / PARTED_JAW_RAD, mouth.shapes["mouthLowerDownLeft"] / PARTED_LIP)
    freedom = dict.fromkeys(LIP_PARTING_SHAPES, free)
    freedom |= dict.fromkeys(LIP_PRESSING_SHAPES, free * np.clip(1.0 - parted, 0.0, 1.0))
    for name, weight in face.emotion_expression.shapes.items():
        weights[:, FACE_SHAPES.index(name)] += weight * emotion_strength * freedom.get(name, 1.0)
    for name, weight in BROW_RAISE_SHAPES.items():
        weights[:, FACE_SHAPES.index(name)] += weight * brows
    for name, column in mouth.shapes.items():
        weights[:, FACE_SHAPES.index(name)] += column
    return np.clip(weights, 0.0, 1.0)


def brow_height(raises: Sequence[BrowRaise], times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
    """Height of the brows at ascending times; of overlapping raises, the higher counts."""
    total = np.zeros(len(times_s))
    for one in raises:
        first, last = np.searchsorted(times_s, [one.onset_s, one.end_s])
        after = times_s[first:last] - one.onset_s
        up = minimum_jerk(after / one.rise_s)
        down = minimum_jerk((after - one.rise_s - one.hold_s) / one.fall_s)
        total[first:last] = np.maximum(total[first:last], one.size * (up - down))
    return total
