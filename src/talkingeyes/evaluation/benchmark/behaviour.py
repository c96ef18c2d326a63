"""What a measure looks at: one motion, as far as its fields go, with what is known of its sound.

Fields that a motion does not have are None; what is derived (gaze in space, saccades, blinks, gaze states) is computed
once, on demand. Frames that hold NaN are not valid: they are filled with their neighbours and never counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import angle_between_deg, head_speed_deg_s
from talkingeyes.core.rotation import direction_to_angles, rotvec_to_direction, rotvec_to_matrix
from talkingeyes.evaluation.detectors.blinks import Blinks, detect_blinks
from talkingeyes.evaluation.detectors.gaze_states import GazeStates, detect_gaze_states
from talkingeyes.evaluation.detectors.saccades import Saccades, detect_saccades

# Dimensions of each field behind its frames.
FIELDS = {"head": (3,), "gaze": (2, 3), "lid": (2,)}
MIN_DURATION_S = 1.0


@dataclass(frozen=True)
class Behaviour:
    """T frames of one person: rotation vectors of head and eye-in-head, closure of the lids, what is being said."""

    fps: float
    head: Float[ndarray, "T 3"] | None
    gaze: Float[ndarray, "T 2 3"] | None
    lid: Float[ndarray, "T 2"] | None
    valid: Bool[ndarray, " T"]
    annotation: Annotation | None = None
    reference: Behaviour | None = None  # a true motion for the same sound
    features: Float[ndarray, "W D"] | None = None  # of windows, by the fixed encoder
    corr: Float[ndarray, "P 2"] | None = None  # by the critics of P parts: under its own sound, under others

    def __len__(self) -> int:
        return len(self.valid)

    def has(self, field: str) -> bool:
        """Whether a field of the motion, or something else that a measure needs, is known."""
        return getattr(self, field) is not None

    @property
    def required_reference(self) -> Behaviour:
        """The reference, for measures that need it."""
        assert self.reference is not None
        return self.reference

    @cached_property
    def valid_steps(self) -> Bool[ndarray, " F"]:
        """Steps between two valid frames."""
        return np.asarray(self.valid[1:] & self.valid[:-1])

    @cached_property
    def times_s(self) -> Float[ndarray, " T"]:
        return np.asarray(np.arange(len(self)) / self.fps)

    @cached_property
    def eye_directions(self) -> Float[ndarray, "T 2 3"]:
        """Directions of the eyes in the head."""
        assert self.gaze is not None
        return rotvec_to_direction(self.gaze)

    @cached_property
    def eye_rad(self) -> Float[ndarray, "T 2 2"]:
        """(yaw, pitch) of each eye in the head."""
        return direction_to_angles(self.eye_directions)

    @cached_property
    def head_rad(self) -> Float[ndarray, "T 2"]:
        """(yaw, pitch) of where the head points."""
        assert self.head is not None
        return direction_to_angles(rotvec_to_direction(self.head))

    @cached_property
    def gaze_in_space_directions(self) -> Float[ndarray, "T 2 3"]:
        """Directions of gaze in space, R(head) R(eye)."""
        assert self.head is not None
        return np.asarray(np.einsum("tij,tej->tei", rotvec_to_matrix(self.head), self.eye_directions))

    @cached_property
    def gaze_in_space_rad(self) -> Float[ndarray, "T 2"]:
        """(yaw, pitch) of gaze in space, the mean direction of both eyes."""
        return direction_to_angles(self.gaze_in_space_directions.mean(axis=1))

    @cached_property
    def eye_speed_deg_s(self) -> Float[ndarray, " F"]:
        """Of eye-in-head, mean of both eyes."""
        return _speed_deg_s(self.eye_directions, self.fps)

    @cached_property
    def gaze_in_space_speed_deg_s(self) -> Float[ndarray, " F"]:
        """Of gaze in space, mean of both eyes."""
        return _speed_deg_s(self.gaze_in_space_directions, self.fps)

    @cached_property
    def head_speed_deg_s(self) -> Float[ndarray, " F"]:
        """Of the head, roll included."""
        assert self.head is not None
        return head_speed_deg_s(self.head, self.fps)

    @cached_property
    def saccades(self) -> Saccades:
        """Rapid shifts of gaze in space."""
        return detect_saccades(self.gaze_in_space_rad, self.fps, self.valid)

    @cached_property
    def in_saccade(self) -> Bool[ndarray, " F"]:
        """Steps that touch a saccade."""
        edges = np.zeros(len(self) + 1, int)
        np.add.at(edges, self._step(np.floor(self.saccades.onset_s * self.fps + 1e-6)), 1)
        np.add.at(edges, self._step(np.ceil(self.saccades.offset_s * self.fps - 1e-6)), -1)
        return np.asarray(np.cumsum(edges)[: len(self) - 1] > 0)

    def _step(self, position: Float[ndarray, " N"]) -> Int[ndarray, " N"]:
        return np.asarray(np.clip(position.astype(int), 0, len(self)))

    @cached_property
    def states(self) -> GazeStates:
        """Looking at the partner, or averted; where the partner is, is estimated from the gaze itself."""
        return detect_gaze_states(self.gaze_in_space_rad, self.fps, valid=self.valid)

    @cached_property
    def blinks(self) -> Blinks:
        """Closures of the lids."""
        assert self.lid is not None
        return detect_blinks(self.lid, self.fps, self.valid)


def behaviour(
    fps: float,
    fields: Mapping[str, ndarray],
    valid: ndarray | None = None,
    annotation: Annotation | None = None,
    reference: Behaviour | None = None,
) -> Behaviour:
    """A behaviour of the fields that there are. Raises InputError for a wrong shape, a wrong rate, or nothing valid."""
    known = {name: np.asarray(fields[name], np.float64) for name in FIELDS if name in fields}
    if not known:
        raise InputError(f"a motion should have one of {', '.join(FIELDS)}, got {', '.join(fields) or 'none'}")
    frames = len(next(iter(known.values())))
    for name, array in known.items():
        if array.shape != (frames, *FIELDS[name]):
            raise InputError(f"{name} should have shape {(frames, *FIELDS[name])}, got {array.shape}")
    if not (np.isfinite(fps) and fps > 0 and frames >= MIN_DURATION_S * fps):
        raise InputError(
            f"a motion should last {MIN_DURATION_S:g} s or longer, got {frames} frames at {fps:g} a second"
        )
    good = np.ones(frames, bool) if valid is None else np.asarray(valid, bool).copy()
    for array in known.values():
        good &= np.isfinite(array.reshape(frames, -1)).all(axis=1)
    if not good.any():
        raise InputError("a motion should have a valid frame, got none")
    filled = {name: array if good.all() else array[_nearest(good)] for name, array in known.items()}
    return Behaviour(fps, filled.get("head"), filled.get("gaze"), filled.get("lid"), good, annotation, reference)


def with_references(takes: Sequence[Behaviour]) -> list[Behaviour]:
    """Each take with the next as its reference; a single one has none."""
    if len(takes) < 2:
        return list(takes)
    return [replace(take, reference=takes[(index + 1) % len(takes)]) for index, take in enumerate(takes)]


def _nearest(good: Bool[ndarray, " T"]) -> Int[ndarray, " T"]:
    """For each frame the last valid one, before the first valid one that one."""
    last = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
    return np.asarray(np.where(last < 0, int(np.argmax(good)), last))


def _speed_deg_s(unit: Float[ndarray, "T 2 3"], fps: float) -> Float[ndarray, " F"]:
    return np.asarray(angle_between_deg(unit[:-1], unit[1:]).mean(axis=-1) * fps)
