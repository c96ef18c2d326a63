"""Windows of recordings at the frame rate of poses, for models of head poses and for PGFace."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

MIN_POSE_SD = 1e-6  # dimensions of lower spread are not scaled


@runtime_checkable
class PosedSpeech(Protocol):
    """A recording with speech embedding and poses."""

    @property
    def speech(self) -> Float[ndarray, "T C"]: ...

    @property
    def pose(self) -> Float[ndarray, "T 6"]: ...

    def __len__(self) -> int: ...


class PoseWindowSampler:
    """Samples starts of windows: indices of a recording and of its first frame."""

    def __init__(self, recordings: Sequence[PosedSpeech], frames: int, hop: int, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.starts = [
            (index, start) for index, each in enumerate(recordings) for start in range(0, len(each) - frames + 1, hop)
        ]

    def sample(self, batch: int) -> list[tuple[int, int]]:
        """The starts of a batch."""
        return [self.starts[int(each)] for each in self.rng.integers(len(self.starts), size=batch)]


def cut_windows(
    recordings: Sequence[PosedSpeech], starts: Sequence[tuple[int, int]], frames: int, shift: int = 0
) -> tuple[Float[Tensor, "B T C"], Float[Tensor, "B T 6"]]:
    """Speech and poses of windows, shifted by `shift` frames."""
    parts = [(recordings[index], slice(start + shift, start + shift + frames)) for index, start in starts]
    return (
        torch.from_numpy(np.stack([each.speech[part] for each, part in parts])),
        torch.from_numpy(np.stack([each.pose[part] for each, part in parts])),
    )


def pose_scale(recordings: Sequence[PosedSpeech]) -> Float[ndarray, " 6"]:
    """Standard deviation of each dimension; 1 for one that does not vary."""
    deviation = np.concatenate([each.pose for each in recordings]).std(0)
    return np.where(deviation > MIN_POSE_SD, deviation, 1.0).astype(np.float32)
