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
from jaxtyping import Float, Int
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
    """Concatenated training motions, of head and gaze or of the face: clip i is frames starts[i] to starts[i + 1].

    `features` are means and standard deviations of the speech embedding over each clip, standardised by `mean` and
    `std`, the statistics of the embedding in the train split.
    """

    starts: ndarray
    motion: Float[ndarray, "F N"]
    features: Float[ndarray, "M D"]
    mean: Float[ndarray, " C"]
    std: Float[ndarray, " C"]

    @classmethod
    def of(
        cls,
        speech: Sequence[Float[ndarray, "T C"]],
        motions: Sequence[Float[ndarray, "T M"]],
        mean: Float[ndarray, " C"],
        std: Float[ndarray, " C"],
    ) -> MotionBank:
        """A bank of the motions of training clips and their speech embeddings."""
        return cls(
            starts=np.cumsum([0, *map(len, motions)]),
            motion=np.concatenate(motions).astype(np.float32),
            features=np.stack([mean_and_std(standardise(each, mean, std)) for each in speech]),
            mean=mean,
            std=std,
        )


def standardise(
    embedding: Float[ndarray, "T C"], mean: Float[ndarray, " C"], std: Float[ndarray, " C"]
) -> Float[ndarray, "T C"]:
    """An embedding with mean 0 and standard deviation 1 in each channel of the train split."""
    return np.asarray((embedding - mean) / np.maximum(std, 1e-6))


def mean_and_std(standardised: Float[ndarray, "T C"]) -> Float[ndarray, " D"]:
    """Descriptor of a sound that Similar Sample compares."""
    return np.concatenate([standardised.mean(0), standardised.std(0)]).astype(np.float32)


def nearest_sounds(
    features: Float[ndarray, "M D"], standardised: Float[ndarray, "T C"], count: int
) -> Int[ndarray, " N"]:
    """Rows of `features` (`mean_and_std` of training sounds) nearest to a sound, the nearest first."""
    distance = np.linalg.norm(features - mean_and_std(standardised), axis=1)
    return np.argsort(distance, kind="stable")[:count]


def sample_bank(
    settings: BaselineSettings, bank: MotionBank, embedding: Float[ndarray, "T C"], seeds: Sequence[int]
) -> Float[ndarray, "B T M"]:
    """Motions of the bank for a sound, one row per seed. Frames beyond the longest training clip hold its last pose."""
    standardised = standardise(embedding, bank.mean, bank.std)
    return np.stack([_sample_one(settings, bank, standardised, np.random.default_rng(seed)) for seed in seeds])


def _sample_one(
    settings: BaselineSettings,
    bank: MotionBank,
    standardised: Float[ndarray, "T C"],
    rng: np.random.Generator,
) -> Float[ndarray, "T M"]:
    frames = len(standardised)
    if settings.kind == "mean":
        return np.repeat(bank.motion.mean(0, keepdims=True), frames, axis=0)
    lengths = np.diff(bank.starts)
    candidates = np.flatnonzero(lengths >= min(frames, lengths.max()))
    if settings.kind == "similar":
        candidates = candidates[nearest_sounds(bank.features[candidates], standardised, settings.neighbours)]
    clip = int(rng.choice(candidates))
    source = bank.motion[bank.starts[clip] : bank.starts[clip + 1]]
    if settings.kind == "random":
        offset = int(rng.integers(max(len(source) - frames, 0) + 1))
        source = source[offset:]
    source = source[:frames]
    return np.concatenate([source, np.repeat(source[-1:], frames - len(source), axis=0)])
