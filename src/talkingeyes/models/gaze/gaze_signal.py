"""Signals that a gaze codebook can encode: eye-in-head as in the paper, or gaze in space.

Gaze in space is still in nine of ten frames, while eye-in-head counter-rotates with the head. So codes of gaze in space
represent gaze shifts alone, and rendering adds the head: eye = head^-1 gaze.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.core import rotation

SignalName = Literal["eye_in_head", "gaze_in_space"]
SIGNAL_DIMS: dict[SignalName, int] = {"eye_in_head": 6, "gaze_in_space": 4}


def to_signal(name: SignalName, head: Float[ndarray, "*N 3"], gaze: Float[ndarray, "*N 2 3"]) -> Float[ndarray, "*N F"]:
    """Left then right eye: rotation vectors (6 numbers) or yaw and pitch in space (4 numbers), radians."""
    values = gaze if name == "eye_in_head" else rotation.gaze_in_space(head, gaze)
    return values.reshape(*values.shape[:-2], SIGNAL_DIMS[name]).astype(np.float32)


def to_gaze(name: SignalName, head: Float[ndarray, "*N 3"], signal: Float[ndarray, "*N F"]) -> Float[ndarray, "*N 2 3"]:
    """Eye-in-head rotation vectors of a signal; the inverse of `to_signal` for eyes without torsion."""
    if name == "eye_in_head":
        return signal.reshape(*signal.shape[:-1], 2, 3)
    return rotation.eye_in_head(head, signal.reshape(*signal.shape[:-1], 2, 2))


def to_signal_tensor(
    name: SignalName, head: Float[Tensor, "*N 3"], gaze: Float[Tensor, "*N 2 3"]
) -> Float[Tensor, "*N F"]:
    """`to_signal` for tensors on any device."""
    return torch.from_numpy(to_signal(name, head.cpu().numpy(), gaze.cpu().numpy())).to(head.device)


def to_gaze_tensor(
    name: SignalName, head: Float[Tensor, "*N 3"], signal: Float[Tensor, "*N F"]
) -> Float[Tensor, "*N 2 3"]:
    """`to_gaze` for tensors on any device."""
    return torch.from_numpy(to_gaze(name, head.cpu().numpy(), signal.cpu().numpy())).to(head.device)


def split_gaze(
    name: SignalName, heads: Sequence[Float[Tensor, "_ _ 3"]], signal: Float[Tensor, "B T F"]
) -> list[Float[Tensor, "_ _ 2 3"]]:
    """`to_gaze_tensor` for several heads of any lengths, whose rows follow each other in a padded signal."""
    parts = signal.split([len(head) for head in heads])
    return [to_gaze_tensor(name, head, part[:, : head.shape[1]]) for head, part in zip(heads, parts, strict=True)]


def find_stays(patches: Float[ndarray, "B N P F"], tolerance_rad: float) -> Bool[ndarray, "B N"]:
    """Patches within the tolerance of the last frame of the last patch that moved; never the first patch."""
    still = np.zeros(patches.shape[:2], bool)
    anchor = patches[:, 0, -1]
    for index in range(1, patches.shape[1]):
        patch = patches[:, index]
        still[:, index] = np.abs(patch - anchor[:, None]).max(axis=(1, 2)) < tolerance_rad
        anchor = np.where(still[:, index, None], anchor, patch[:, -1])
    return still


def mirror_motion(
    head: Float[ndarray, "T 3"], gaze: Float[ndarray, "T 2 3"]
) -> tuple[Float[ndarray, "T 3"], Float[ndarray, "T 2 3"]]:
    """Mirror a motion: yaw and roll change sign, the eyes are swapped."""
    sign = np.array([1, -1, -1], head.dtype)
    return head * sign, gaze[:, ::-1] * sign
