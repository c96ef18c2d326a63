"""Conditioning inputs of windows and whole clips, for models that need them (models/condition/).

An unseen speaker is replaced by a random training speaker, chosen by the sound.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus
from talkingeyes.models.condition.conditioner import ConditioningInputs, InputName
from talkingeyes.models.condition.emotion_strength import emotion_strengths
from talkingeyes.models.condition.random_speaker import random_speaker
from talkingeyes.models.face.style import clip_style

WindowInputs = Mapping[str, ndarray]


@dataclass(frozen=True)
class ConditioningPaths:
    """Where the sound and its embedding are."""

    corpus: Corpus
    embed: Path


class ConditioningProvider:
    """Provides the conditioning inputs of clips."""

    def __init__(
        self,
        required_inputs: Collection[InputName],
        speakers: Sequence[str],
        conditioning_paths: ConditioningPaths | None,
    ) -> None:
        self.required_inputs, self.speakers = required_inputs, list(speakers)
        self.conditioning_paths = conditioning_paths

    def window(self, clip: Clip, frames: slice, mirror: bool) -> WindowInputs:
        """Inputs of some frames of a clip. The same window always gets the same inputs."""
        found = self._own(clip, frames)
        if "speaker" in found and mirror:
            found["speaker"] = np.asarray(found["speaker"] + len(self.speakers))  # the speaker's mirror image
        return found

    def clip_inputs(self, clip: Clip, frames: int) -> ConditioningInputs:
        """Inputs of a whole clip, as one window."""
        return collate_inputs([self._own(clip, slice(0, frames))])

    def _own(self, clip: Clip, frames: slice) -> dict[str, ndarray]:
        found: dict[str, ndarray] = {}
        if "speaker" in self.required_inputs:
            found["speaker"] = np.array(speaker_index(self.speakers, clip.speaker, clip.sound))
        if "emotion" in self.required_inputs:
            found["emotion"] = emotion_strengths(clip_style(clip))[None]  # the same in all frames
        if "sound" in self.required_inputs:
            found["sound"] = self._sound(clip, frames)
        return found

    def _sound(self, clip: Clip, frames: slice) -> Float[ndarray, " N"]:
        if self.conditioning_paths is None:
            raise InputError("speech.waveform_encoder: should be given a corpus with sound, got none")
        step = SAMPLE_RATE / clip.fps
        start, count = round(frames.start * step), round((frames.stop - frames.start) * step)
        return pad_or_trim(self.conditioning_paths.corpus.speech(clip)[start:], count)


WITHOUT_CONDITIONING = ConditioningProvider((), (), None)


def speaker_index(speakers: Sequence[str], name: str, seed_text: str) -> int:
    """Index of a speaker; for an unseen speaker, that of a random training speaker, seeded by a text."""
    return list(speakers).index(name) if name in speakers else random_speaker(speakers, list(seed_text.encode()))


def pad_or_trim(sound: Float[ndarray, " N"], count: int) -> Float[ndarray, " M"]:
    """The first `count` samples, padded with silence."""
    return np.pad(sound[:count], (0, max(count - len(sound), 0))).astype(np.float32)


def motion_array(head: Float[ndarray, "T 3"], gaze: Float[ndarray, "T 2 3"]) -> Float[ndarray, "T 9"]:
    """A motion in one array: head, then both eyes in the head."""
    return np.concatenate([head, gaze.reshape(len(gaze), 6)], axis=1).astype(np.float32)


def collate_inputs(window_inputs: Sequence[WindowInputs]) -> ConditioningInputs:
    """Stack the inputs of windows to a batch."""
    return ConditioningInputs(
        **{name: torch.from_numpy(np.stack([row[name] for row in window_inputs])) for name in window_inputs[0]}
    )
