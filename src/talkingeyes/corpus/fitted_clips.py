"""The fitted clips of a corpus as a lazy sequence, by the function that reads one: motion, head poses or faces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar, overload

import numpy as np
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, shard_path

R = TypeVar("R")
S = TypeVar("S", bound=Sequence[object])


class FittedClips(Sequence[R]):
    """What `read` returns for each clip that was fitted (not rejected), on demand."""

    def __init__(self, clips: Sequence[Clip], fit: Path, read: Callable[[Clip], R]) -> None:
        self.clips = [clip for clip in clips if motion_path(fit, clip).exists()]
        self._read = read

    def __len__(self) -> int:
        return len(self.clips)

    @overload
    def __getitem__(self, index: int) -> R: ...
    @overload
    def __getitem__(self, index: slice) -> list[R]: ...
    def __getitem__(self, index: int | slice) -> R | list[R]:
        if isinstance(index, slice):
            return [self._read(clip) for clip in self.clips[index]]
        return self._read(self.clips[index])

    def __iter__(self) -> Iterator[R]:
        return map(self._read, self.clips)


def read_frames(embed: Path, clip: Clip, motion: Sequence[ndarray]) -> list[ndarray]:
    """The speech embedding of a clip, memory-mapped, and its motion, all cut to the shorter."""
    speech = np.load(shard_path(embed / "speech", clip.sound, ".npy"), mmap_mode="r")
    frames = min(len(speech), len(motion[0]))
    return [each[:frames] for each in (speech, *motion)]


def motion_path(fit: Path, clip: Clip) -> Path:
    """The file of a clip's fitted motion."""
    return shard_path(fit / "motion", clip.id, ".npz")


def require_clips(found: S, corpus: Corpus, splits: Sequence[str]) -> S:
    """The clips found in these splits. Raises InputError if there is none."""
    if not len(found):
        raise InputError(
            f"{corpus.root}: should contain fitted clips in {', '.join(splits)}, got none; every split needs clips"
        )
    return found
