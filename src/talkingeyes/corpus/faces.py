"""Training data of face models: speech embedding and fitted face of each clip, frame by frame.

Embeddings are memory-mapped and motions read on demand, so memory does not grow with the corpus.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.fitted_clips import FittedClips, motion_path, read_frames
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus


@dataclass(frozen=True)
class FaceRecording:
    """One clip: speech embedding, expression and jaw (rotation vectors) of its T frames."""

    clip: Clip
    speech: Float[ndarray, "T C"]
    expression: Float[ndarray, "T E"]
    jaw: Float[ndarray, "T 3"]

    def __len__(self) -> int:
        return len(self.jaw)


class FaceRecordings(FittedClips[FaceRecording]):
    """Faces of fitted clips; 2,048 are cached. All belong to one head: `head_model` with `expression_names`."""

    def __init__(self, clips: Sequence[Clip], fit: Path, embed: Path) -> None:
        """Raises InputError if no clip was fitted."""
        read_face = lru_cache(maxsize=2048)(lambda clip: self._face(fit, clip))
        super().__init__(clips, fit, lambda clip: FaceRecording(clip, *read_frames(embed, clip, read_face(clip))))
        if not self.clips:
            raise InputError(f"{fit}: should contain fitted clips, got none; every split needs clips")
        first = Motion.load(motion_path(fit, self.clips[0]))
        self.head_model, self.expression_names = first.head_model, first.expression_names

    def _face(self, fit: Path, clip: Clip) -> tuple[ndarray, ndarray]:
        motion = Motion.load(motion_path(fit, clip))
        if (motion.head_model, motion.expression_names) != (self.head_model, self.expression_names):
            raise InputError(
                f"{clip.id}: all motions should be of one head, {self.head_model} with "
                f"{len(self.expression_names)} shapes, got {motion.head_model} with {len(motion.expression_names)}"
            )
        return motion.expression.astype(np.float32), motion.jaw.astype(np.float32)


def face_recordings(corpus: Corpus, fit: Path, embed: Path, *splits: str, take: int | None = None) -> FaceRecordings:
    """The fitted clips of the given splits."""
    return FaceRecordings(corpus.select(*splits, take=take), fit, embed)
