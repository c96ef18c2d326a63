"""The face beside eyes and speech: what eight emotions do to it, and brows that rise; in shapes of the head by name.

Emotions are those of 3DMEAD (ProbTalk3D, section 3.1) at three intensities, as EMFACS describes them (Ekman, Friesen &
Hager 2002), action units translated to ARKit's shapes: happy 6+12, sad 1+4+15+17, surprised 1+2+5+26, fear
1+2+4+5+20, disgusted 9+10+15, angry 4+5+7+23, contempt 12+14 of one side. Unit 5, the raised upper lid, is a negative
`Motion.lid`, unit 26 the jaw's rest. Sizes at full intensity are our own [U]. They come and go by a fifth and leave
the mouth to speech: whatever would part the lips stays out while they are closed.
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


# What a Motion of the open head carries: ARKit's 52 without gaze, blink and jaw (a test holds the head to it).
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
INTENSITY_STRENGTH = (0.0, 0.4, 0.7, 1.0)
BROW_RAISE_SHAPES: Mapping[str, float] = {"browInnerUp": 0.8, "browOuterUpLeft": 1.0, "browOuterUpRight": 1.0}


@dataclass(frozen=True)
class EmotionExpression:
    """An emotion in the face at full intensity: weights of shapes (both sides where a name has sides), closure that
    is added to the lids, the angle at which the jaw rests, and a factor on how far it opens in speech."""

    shapes: Mapping[str, float]
    lid: float = 0.0
    jaw_rest_rad: float = 0.0
    jaw_scale: float = 1.0


def _expand_sides(**weights: float) -> Mapping[str, float]:
    """Weights by the names of FACE_SHAPES; a name without its side stands for both."""
    return {
        shape: weight
        for name, weight in weights.items()
        for shape in ((name,) if name in FACE_SHAPES else (f"{name}Left", f"{name}Right"))
    }


EMOTION_EXPRESSIONS: Mapping[str, EmotionExpression] = MappingProxyType(
    {
        "neutral": EmotionExpression({}),
        "happy": EmotionExpression(_expand_sides(cheekSquint=0.5, mouthSmile=0.55, mouthDimple=0.1), 0.04, 0.0, 1.1),
        "sad": EmotionExpression(
            _expand_sides(browInnerUp=0.7, browDown=0.2, mouthFrown=0.45, mouthShrugLower=0.15), 0.12, 0.0, 0.85
        ),
        "surprised": EmotionExpression(_expand_sides(browInnerUp=0.8, browOuterUp=0.8), -0.18, 0.05, 1.15),
        "fear": EmotionExpression(
            _expand_sides(browInnerUp=0.8, browOuterUp=0.35, browDown=0.3, mouthStretch=0.4), -0.15, 0.02, 1.0
        ),
        "disgusted": EmotionExpression(
            _expand_sides(noseSneer=0.5, mouthUpperUp=0.2, mouthFrown=0.3, browDown=0.35, cheekSquint=0.2),
            0.08,
            0.0,
            0.95,
        ),
        "angry": EmotionExpression(
            _expand_sides(browDown=0.8, eyeSquint=0.2, mouthPress=0.2, noseSneer=0.12), -0.06, 0.0, 1.15
        ),
        "contempt": EmotionExpression(_expand_sides(mouthSmileLeft=0.35, mouthDimpleLeft=0.5), 0.06, 0.0, 0.95),
    }
)


@dataclass(frozen=True)
class BrowRaise:
    """The brows rise, stay and fall; `size` 1 is as far as they go."""

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
    """What the face does in a take beside speech. `share` is how much of the emotion shows (0 to 1)."""

    emotion: str = "neutral"
    share: float = 0.0
    brows: tuple[BrowRaise, ...] = ()

    @property
    def emotion_expression(self) -> EmotionExpression:
        """The emotion at full intensity."""
        return EMOTION_EXPRESSIONS[self.emotion]


def expression(
    face: FacialBehaviour, mouth: MouthMotion, times_s: Float[ndarray, " T"], strength_over_time: Float[ndarray, " T"]
) -> Float[ndarray, "T C"]:
    """Weights of FACE_SHAPES, 0 to 1. `strength_over_time` is how strongly the emotion shows at each time, about 1."""
    weights = np.zeros((len(times_s), len(FACE_SHAPES)))
    brows = brow_height(face.brows, times_s)
    felt = face.share * strength_over_time
    for name, weight in face.emotion_expression.shapes.items():
        weights[:, FACE_SHAPES.index(name)] += (
            weight * felt * (1.0 - mouth.closed if name in LIP_PARTING_SHAPES else 1.0)
        )
    for name, weight in BROW_RAISE_SHAPES.items():
        weights[:, FACE_SHAPES.index(name)] += weight * brows
    for name, column in mouth.shapes.items():
        weights[:, FACE_SHAPES.index(name)] += column
    return np.clip(weights, 0.0, 1.0)


def brow_height(raises: Sequence[BrowRaise], times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
    """How far the brows are up at ascending times; of raises that overlap, the higher counts."""
    total = np.zeros(len(times_s))
    for one in raises:
        first, last = np.searchsorted(times_s, [one.onset_s, one.end_s])
        after = times_s[first:last] - one.onset_s
        up = minimum_jerk(after / one.rise_s)
        down = minimum_jerk((after - one.rise_s - one.hold_s) / one.fall_s)
        total[first:last] = np.maximum(total[first:last], one.size * (up - down))
    return total
