"""Windows of 256 frames of poses, as used by every measurement of the paper (section 4.3): sliding, or end to end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.corpus.poses import PoseRecording


@dataclass(frozen=True)
class PoseWindows:
    """N windows of L frames: standardised speech embedding, centred poses, and speaker indices."""

    speech: Float[ndarray, "N L C"]
    pose: Float[ndarray, "N L 6"]
    speaker: Int[ndarray, " N"]

    def __len__(self) -> int:
        return len(self.pose)


def sliding_windows(frames: Float[ndarray, "T C"], length: int, hop: int) -> Float[ndarray, "N L C"]:
    """Windows of an array, `hop` frames apart; none if it is shorter than a window."""
    starts = np.arange(0, len(frames) - length + 1, hop)
    return np.asarray(frames[starts[:, None] + np.arange(length)])


def pose_windows(recordings: Sequence[PoseRecording], speakers: Sequence[str], length: int, hop: int) -> PoseWindows:
    """Windows of recordings of the given speakers; others are left out."""
    known = [each for each in recordings if each.clip.speaker in speakers and len(each) >= length]
    poses = [sliding_windows(each.pose, length, hop) for each in known]
    return PoseWindows(
        speech=np.concatenate([sliding_windows(each.speech, length, hop) for each in known]),
        pose=np.concatenate(poses),
        speaker=np.repeat([speakers.index(each.clip.speaker) for each in known], [len(pose) for pose in poses]),
    )
