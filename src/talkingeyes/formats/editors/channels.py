"""Eyes and head of a motion as numbers by name, for files that name their columns (tables, JSON).

Names are compared by shape_names.py, in small letters.

    eyeBlinkLeft, eyeLookInLeft, ...     ARKit's fourteen, as our writers have them (formats/arkit.py)
    eyesLookLeft, eyesCloseL, squintL    Audio2Face's own; one direction for both eyes
    eyesClosed                           one for both lids
    HeadYaw, LeftEyeYaw, ...             Live Link Face
    Yaw, Pitch, Roll, gaze_yaw, ...      py-feat; gaze in space, one direction for both eyes
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.rotations import euler_yxz
from talkingeyes.formats.shape_names import EYE_EQUIVALENTS, shape_names
from talkingeyes.head.posing import SIDES

ARKIT_EYES = tuple(f"{what}{side}" for side in SIDES for what in arkit.EYE_COEFFICIENTS)


@dataclass(frozen=True)
class AddedEyes:
    """What goes into a file: a motion whose gaze is the forward axes of its eyes, with a frame for each of the file.

    Without `with_head`, the head of the file stays. `share` is the share of ours where the file has values: 0 to 1.
    """

    motion: Motion
    with_head: bool
    share: float

    def mixed(self, own: Float[ndarray, "*N"], new: Float[ndarray, "*N"]) -> Float[ndarray, "*N"]:
        """Values of the file and ours, mixed."""
        return np.asarray(own + self.share * (new - own)) if self.share < 1 else new

    def mixed_turns(self, own: Float[ndarray, "T 3"], new: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
        """Rotation vectors of the file and ours, mixed along the shorter arc."""
        if self.share >= 1:
            return new
        start = Rotation.from_rotvec(own)
        step = (start.inv() * Rotation.from_rotvec(new)).as_rotvec()
        return np.asarray((start * Rotation.from_rotvec(self.share * step)).as_rotvec())


def channel_name(name: str) -> str:
    """The name of one shape by which its values are found."""
    return shape_names([name])[0].lower()


def channel_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names of the shapes of a file by which their values are found."""
    return tuple(name.lower() for name in shape_names(names))


def arkit_channels(motion: Motion) -> dict[str, Float[ndarray, " T"]]:
    """ARKit's eye coefficients by name."""
    table = dict(zip(arkit.NAMES, arkit.coefficients(motion).T, strict=True))
    return {name: table[name] for name in ARKIT_EYES}


def eye_channels(motion: Motion, names: Collection[str] = ()) -> dict[str, Float[ndarray, " T"]]:
    """Values of the coefficients of the eyes, by `channel_name`.

    Where a file has, by `names`, a coefficient of both eyes and those of each, the one of both is 0.
    """
    own = arkit_channels(motion)
    yaw, pitch = rotation.cyclopean_gaze(rotation.gaze_to_angles(motion.gaze)).T / arkit.LOOK_RANGE_RAD
    looks = {"eyesLookLeft": yaw, "eyesLookRight": -yaw, "eyesLookUp": pitch, "eyesLookDown": -pitch}
    shared = {
        theirs: np.clip(looks[theirs], 0, 1) if theirs in looks else np.mean([own[name] for name in ours], axis=0)
        for theirs, ours in EYE_EQUIVALENTS.items()
    }
    for theirs, ours in EYE_EQUIVALENTS.items():
        if {name.lower() for name in ours} <= set(names):
            shared[theirs] = np.zeros(len(motion))
    return {name.lower(): values for name, values in (own | shared).items()}


EYE_NAMES = frozenset(eye_channels(Motion.of(1.0, np.zeros((1, 3)), np.zeros((1, 2, 3)))))


def angle_channels(motion: Motion, factors: Float[ndarray, " 9"]) -> dict[str, Float[ndarray, " T"]]:
    """The nine angles of Live Link Face; `factors` lead from the angles of the file to those of `euler_yxz`."""
    turned = np.concatenate([euler_yxz(each) for each in (motion.head, motion.gaze[:, 0], motion.gaze[:, 1])], axis=1)
    return dict(zip((name.lower() for name in arkit.ANGLES), (turned / factors).T, strict=True))


def pyfeat_channels(motion: Motion) -> dict[str, Float[ndarray, " T"]]:
    """Head and gaze in space of py-feat (readers/trackers.py)."""
    head = dict(zip(("yaw", "pitch", "roll"), (euler_yxz(motion.head) * [-1.0, 1.0, 1.0]).T, strict=True))
    yaw, pitch = rotation.cyclopean_gaze(rotation.gaze_in_space(motion.head, motion.gaze)).T
    return {**head, "gaze_yaw": yaw, "gaze_pitch": pitch, "gaze_angle": np.hypot(yaw, pitch)}
