"""Training data of face models: speech embedding and fitted face of each clip, frame by frame.

Embeddings are memory-mapped and motions read on demand, so memory does not grow with the corpus.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import overload

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, shard_path


@dataclass(frozen=True)
class FaceRecording:
    """One clip: speech embedding, expression and jaw (rotation vectors) of its T frames."""

    clip: Clip
    speech: Float[ndarray, "T C"]
    expression: Float[ndarray, "T E"]
    jaw: Float[ndarray, "T 3"]

    def __len__(self) -> int:
        return len(self.jaw)


class FaceRecordings(Sequence[FaceRecording]):
    """The fitted clips of some splits (without rejected ones), read lazily; 2,048 faces are cached.

    All faces belong to one head: `head_model` with `expression_names`.
    """

    def __init__(self, clips: Sequence[Clip], fit: Path, embed: Path) -> None:
        """Raises InputError if no clip was fitted."""
        self.clips = [clip for clip in clips if _path(fit, clip).exists()]
        if not self.clips:
            raise InputError(f"{fit}: should contain fitted clips, got none; every split needs clips")
        first = Motion.load(_path(fit, self.clips[0]))
        self.head_model, self.expression_names = first.head_model, first.expression_names
        self._embed, self._fit = embed, fit
        self._face = lru_cache(maxsize=2048)(self._read)

    def __len__(self) -> int:
        return len(self.clips)

    @overload
    def __getitem__(self, index: int) -> FaceRecording: ...
    @overload
    def __getitem__(self, index: slice) -> list[FaceRecording]: ...
    def __getitem__(self, index: int | slice) -> FaceRecording | list[FaceRecording]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        clip = self.clips[index]
        expression, jaw = self._face(clip)
        speech = np.load(shard_path(self._embed / "speech", clip.sound, ".npy"), mmap_mode="r")
        frames = min(len(speech), len(jaw))
        return FaceRecording(clip, speech[:frames], expression[:frames], jaw[:frames])

    def __iter__(self) -> Iterator[FaceRecording]:
        return (self[index] for index in range(len(self)))

    def _read(self, clip: Clip) -> tuple[ndarray, ndarray]:
        motion = Motion.load(_path(self._fit, clip))
        if (motion.head_model, motion.expression_names) != (self.head_model, self.expression_names):
            raise InputError(
                f"{clip.id}: all motions should be of one head, {self.head_model} with "
                f"{len(self.expression_names)} shapes, got {motion.head_model} with {len(motion.expression_names)}"
            )
        return motion.expression.astype(np.float32), motion.jaw.astype(np.float32)


def face_recordings(corpus: Corpus, fit: Path, embed: Path, *splits: str) -> FaceRecordings:
    """The fitted clips of the given splits."""
    return FaceRecordings(corpus.select(*splits), fit, embed)


def _path(fit: Path, clip: Clip) -> Path:
    return shard_path(fit / "motion", clip.id, ".npz")
