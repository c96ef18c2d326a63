"""Style of a face: speaker, emotion and intensity (ProbTalk3D section 3.2: C = [c_id|c_emo|c_int]).

The style vector consists of one-hot vectors. An unseen speaker is represented by the mean of the training speakers. A
neutral face has no intensity. The style may change along a clip: the vectors of successive keys are crossfaded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.physiology.face import EMOTION_EXPRESSIONS

EMOTIONS = tuple(EMOTION_EXPRESSIONS)
INTENSITIES, DEFAULT_INTENSITY = (1, 2, 3), 2
NEUTRAL = "neutral"
STYLE_FADE_S = 0.5  # crossfade of style changes within a clip
StyleInput = Literal["speaker", "emotion", "intensity"]


def default_intensity(emotion: str, intensity: int | None) -> int:
    """The intensity of an emotion, with its default."""
    if intensity is not None:
        return intensity
    return 0 if emotion == NEUTRAL else DEFAULT_INTENSITY


@dataclass(frozen=True)
class FaceStyle:
    """`speaker` None: the mean of all; `intensity` 0: neutral only. Raises InputError that lists the valid values."""

    speaker: str | None
    emotion: str
    intensity: int

    def __post_init__(self) -> None:
        if self.emotion not in EMOTIONS:
            raise InputError(f"emotion: should be one of {', '.join(EMOTIONS)}, got {self.emotion}")
        if self.emotion == NEUTRAL and self.intensity:
            raise InputError(f"intensity: should be 0 with a neutral face, got {self.intensity}")
        if self.emotion != NEUTRAL and self.intensity not in INTENSITIES:
            raise InputError(f"intensity: should be 1, 2 or 3 with {self.emotion}, got {self.intensity}")


@dataclass(frozen=True)
class StyleKey:
    """A style that starts at `onset_s`."""

    onset_s: float
    style: FaceStyle


@dataclass(frozen=True)
class StyleVocabulary:
    """Training speakers of a model, in index order."""

    speakers: tuple[str, ...]

    @classmethod
    def of(cls, clips: Iterable[Clip]) -> StyleVocabulary:
        """The speakers of clips, sorted by name."""
        return cls(tuple(sorted({clip.speaker for clip in clips})))

    @property
    def numbers(self) -> int:
        """Dimensions of a style vector."""
        return len(self.speakers) + len(EMOTIONS) + len(INTENSITIES)

    def columns(self, inputs: Sequence[StyleInput]) -> list[int]:
        """Columns of a style vector for these inputs."""
        emotions = len(self.speakers)
        intensities = emotions + len(EMOTIONS)
        ranges: dict[StyleInput, range] = {
            "speaker": range(emotions),
            "emotion": range(emotions, intensities),
            "intensity": range(intensities, self.numbers),
        }
        return [column for name in inputs for column in ranges[name]]

    def style_vector(self, style: FaceStyle) -> Float[ndarray, " D"]:
        """Style vector C of a style. Raises InputError for an unknown speaker."""
        if style.speaker is not None and style.speaker not in self.speakers:
            raise InputError(
                f"speaker: should be one of {', '.join(self.speakers)} or none for their mean, got {style.speaker}"
            )
        style_vector = np.zeros(self.numbers, np.float32)
        if style.speaker is None:
            style_vector[: len(self.speakers)] = 1 / len(self.speakers)
        else:
            style_vector[self.speakers.index(style.speaker)] = 1
        style_vector[len(self.speakers) + EMOTIONS.index(style.emotion)] = 1
        if style.intensity:
            style_vector[len(self.speakers) + len(EMOTIONS) + style.intensity - 1] = 1
        return style_vector

    def per_frame(self, keys: Sequence[StyleKey], frames: int, fps: float) -> Float[ndarray, "T D"]:
        """C of every frame."""
        return blend_over_time(keys, np.arange(frames) / fps, self.style_vector)

    def style_of(self, clip: Clip) -> FaceStyle:
        """Style of a clip: that of `clip_style`, for an unknown speaker with the mean of all."""
        style = clip_style(clip)
        return style if style.speaker in self.speakers else replace(style, speaker=None)


def clip_style(clip: Clip) -> FaceStyle:
    """Style of a clip; neutral if it has no emotion label (a video)."""
    return FaceStyle(clip.speaker, clip.emotion or NEUTRAL, clip.intensity)


def blend_over_time(
    keys: Sequence[StyleKey], times_s: Float[ndarray, " T"], vector: Callable[[FaceStyle], Float[ndarray, " D"]]
) -> Float[ndarray, "T D"]:
    """A vector of the style at each time: that of each key from its onset on, faded in over STYLE_FADE_S; that of the
    first key also before its onset."""
    if not keys:
        raise InputError("style: should have at least one key, got none")
    ordered = sorted(keys, key=lambda key: key.onset_s)
    found = np.repeat(vector(ordered[0].style)[None], len(times_s), axis=0)
    for key in ordered[1:]:
        share = np.clip((times_s - key.onset_s) / STYLE_FADE_S, 0, 1)[:, None].astype(found.dtype)
        found = (1 - share) * found + share * vector(key.style)
    return found
