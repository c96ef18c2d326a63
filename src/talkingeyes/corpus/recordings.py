"""Training data of gaze and head models: speech embedding and fitted motion of each clip, frame by frame.

Embeddings are memory-mapped and motions read on demand, so memory does not grow with the corpus.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core.containers import read_json
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.fitted_clips import FittedClips, motion_path, read_frames, require_clips
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus


@dataclass(frozen=True)
class Recording:
    """One clip: speech embedding, head and eye-in-head rotation vectors of its T frames."""

    clip: Clip
    speech: Float[ndarray, "T C"]
    head: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]
    valid: Bool[ndarray, " T"]

    def __len__(self) -> int:
        return len(self.head)


@dataclass(frozen=True)
class Normaliser:
    """Channel names of the speech embedding, with means and standard deviations over the train split."""

    channels: tuple[str, ...]
    mean: Float[ndarray, " C"]
    std: Float[ndarray, " C"]

    @classmethod
    def of(cls, embed: Path) -> Normaliser:
        """Read from the folder of the embed stage."""
        content = read_json(embed / "embedding.json", "embedding")
        mean, std = (np.asarray(content[name], np.float32) for name in ("mean", "std"))
        return cls(tuple(content["channels"]), mean, std)


class Recordings(FittedClips[Recording]):
    """Head and gaze of fitted clips; 4,096 motions are cached."""

    def __init__(self, clips: Sequence[Clip], fit: Path, embed: Path) -> None:
        read_motion = lru_cache(maxsize=4096)(lambda clip: _read_motion(fit, clip))
        super().__init__(clips, fit, lambda clip: Recording(clip, *read_frames(embed, clip, read_motion(clip))))


def recordings(corpus: Corpus, fit: Path, embed: Path, *splits: str, take: int | None = None) -> Recordings:
    """The fitted clips of the given splits. Raises InputError if there is none."""
    return require_clips(Recordings(corpus.select(*splits, take=take), fit, embed), corpus, splits)


def _read_motion(fit: Path, clip: Clip) -> tuple[ndarray, ndarray, ndarray]:
    motion = Motion.load(motion_path(fit, clip))
    return motion.head.astype(np.float32), motion.gaze.astype(np.float32), motion.valid
