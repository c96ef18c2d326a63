"""The paper's baselines without a network: Mean, Random, Similar Sample (TalkingEyes section V-B.2).

Each takes head and gaze (or the face) from one source, so that gaze in space stays human: Mean uses the mean of the
train split, Random a random training clip with another sound, Similar Sample one of the clips with the most similar
sounds. A longer source is cropped. A shorter one is never looped: only clips of sufficient length are candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings


class BaselineSettings(Settings):
    """Settings of a baseline. Similar Sample chooses among `neighbours` clips (with 1 its Diversity is 0; the paper has
    0.06)."""

    kind: Literal["mean", "random", "similar"]
    parts: tuple[Literal["head", "gaze", "face"], ...]
    tokenizer: None
    neighbours: Annotated[int, Field(gt=0)]


@dataclass(frozen=True)
class MotionBank:
    """Concatenated training motions: clip i is frames starts[i] to starts[i + 1]; `features` describe its sound.

    `features` are means and standard deviations of the standardised speech embedding over the clip.
    """

    starts: ndarray
    motion: Float[ndarray, "F N"]
    features: Float[ndarray, "M D"]

    def max_frames(self) -> int:
        """Frames of the longest clip."""
        return int(np.diff(self.starts).max())


@dataclass(frozen=True)
class BaselineMotion:
    """Head and eye-in-head rotation vectors, one row per seed."""

    head: Float[ndarray, "B T 3"]
    gaze: Float[ndarray, "B T 2 3"]


def mean_and_std(standardised: Float[ndarray, "T C"]) -> Float[ndarray, " D"]:
    """Descriptor of a sound that Similar Sample compares."""
    return np.concatenate([standardised.mean(0), standardised.std(0)]).astype(np.float32)


def build_bank(
    speech: Sequence[Float[ndarray, "T C"]],
    head: Sequence[Float[ndarray, "T 3"]],
    gaze: Sequence[Float[ndarray, "T 2 3"]],
) -> MotionBank:
    """A bank of the head and gaze of training clips; `speech` is standardised."""
    return build_motion_bank(
        speech, [np.concatenate([h, g.reshape(len(g), 6)], axis=1) for h, g in zip(head, gaze, strict=True)]
    )


def build_motion_bank(speech: Sequence[Float[ndarray, "T C"]], motions: Sequence[Float[ndarray, "T M"]]) -> MotionBank:
    """A bank of any motion vectors; a bank of faces holds expression and jaw."""
    return MotionBank(
        starts=np.cumsum([0, *map(len, motions)]),
        motion=np.concatenate(motions).astype(np.float32),
        features=np.stack([mean_and_std(each) for each in speech]),
    )


def generate(
    settings: BaselineSettings, bank: MotionBank, standardised: Float[ndarray, "T C"], seeds: Sequence[int]
) -> BaselineMotion:
    """Head and gaze for a sound, one row per seed."""
    motion = sample_bank(settings, bank, standardised, seeds)
    return BaselineMotion(motion[..., :3], motion[..., 3:].reshape(*motion.shape[:2], 2, 3))


def sample_bank(
    settings: BaselineSettings, bank: MotionBank, standardised: Float[ndarray, "T C"], seeds: Sequence[int]
) -> Float[ndarray, "B T M"]:
    """Motions of the bank for a sound, one row per seed. Frames beyond the longest training clip hold its last pose."""
    frames = len(standardised)
    return np.stack([_sample_one(settings, bank, standardised, frames, np.random.default_rng(seed)) for seed in seeds])


def _sample_one(
    settings: BaselineSettings,
    bank: MotionBank,
    standardised: Float[ndarray, "T C"],
    frames: int,
    rng: np.random.Generator,
) -> Float[ndarray, "T M"]:
    if settings.kind == "mean":
        return np.repeat(bank.motion.mean(0, keepdims=True), frames, axis=0)
    lengths = np.diff(bank.starts)
    candidates = np.flatnonzero(lengths >= min(frames, lengths.max()))
    if settings.kind == "similar":
        distance = np.linalg.norm(bank.features[candidates] - mean_and_std(standardised), axis=1)
        candidates = candidates[np.argsort(distance, kind="stable")[: settings.neighbours]]
    clip = int(rng.choice(candidates))
    source = bank.motion[bank.starts[clip] : bank.starts[clip + 1]]
    if settings.kind == "random":
        offset = int(rng.integers(max(len(source) - frames, 0) + 1))
        source = source[offset:]
    source = source[:frames]
    return np.concatenate([source, np.repeat(source[-1:], frames - len(source), axis=0)])
