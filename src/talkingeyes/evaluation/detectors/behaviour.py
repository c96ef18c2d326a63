"""Input of the metrics: one motion with its optional fields, annotation and derived quantities.

Missing fields are None. Derived quantities (gaze in space, saccades, blinks, gaze states) are computed once, on demand.
Frames that contain NaN are invalid: they are filled from the nearest valid frame before them and never counted.
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

# Shape of each field in one frame.
FIELDS = {"head": (3,), "gaze": (2, 3), "lid": (2,)}
MIN_DURATION_S = 1.0


@dataclass(frozen=True)
class Behaviour:
    """T frames of one person: rotation vectors of head and eye-in-head, lid closure, annotation of the speech."""

    fps: float
    head: Float[ndarray, "T 3"] | None
    gaze: Float[ndarray, "T 2 3"] | None
    lid: Float[ndarray, "T 2"] | None
    valid: Bool[ndarray, " T"]
    annotation: Annotation | None = None
    reference: Behaviour | None = None  # a true motion for the same sound
    features: Float[ndarray, "W D"] | None = None  # of windows, by the fixed encoder
    corr: Float[ndarray, "P 2"] | None = None  # of P parts: under its own sound, mean under other sounds

    def __len__(self) -> int:
        return len(self.valid)

    def has(self, field: str) -> bool:
        """Whether a field of the motion, or another attribute that a metric needs, is present."""
        return getattr(self, field) is not None

    @property
    def required_reference(self) -> Behaviour:
        """The reference, for metrics that need one."""
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
        """(yaw, pitch) of the head's facing direction."""
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
        """Speed of eye-in-head, mean of both eyes."""
        return _speed_deg_s(self.eye_directions, self.fps)

    @cached_property
    def gaze_in_space_speed_deg_s(self) -> Float[ndarray, " F"]:
        """Speed of gaze in space, mean of both eyes."""
        return _speed_deg_s(self.gaze_in_space_directions, self.fps)

    @cached_property
    def head_speed_deg_s(self) -> Float[ndarray, " F"]:
        """Speed of the head, including roll."""
        assert self.head is not None
        return head_speed_deg_s(self.head, self.fps)

    @cached_property
    def saccades(self) -> Saccades:
        """Saccades of gaze in space."""
        return detect_saccades(self.gaze_in_space_rad, self.fps, self.valid)

    @cached_property
    def in_saccade(self) -> Bool[ndarray, " F"]:
        """Steps between frames that overlap a saccade."""
        edges = np.zeros(len(self) + 1, int)
        np.add.at(edges, self._step(np.floor(self.saccades.onset_s * self.fps + 1e-6)), 1)
        np.add.at(edges, self._step(np.ceil(self.saccades.offset_s * self.fps - 1e-6)), -1)
        return np.asarray(np.cumsum(edges)[: len(self) - 1] > 0)

    def _step(self, position: Float[ndarray, " N"]) -> Int[ndarray, " N"]:
        return np.asarray(np.clip(position.astype(int), 0, len(self)))

    @cached_property
    def states(self) -> GazeStates:
        """Gaze at the partner or averted; the location of the partner is estimated from the gaze."""
        return detect_gaze_states(self.gaze_in_space_rad, self.fps, valid=self.valid)

    @cached_property
    def blinks(self) -> Blinks:
        """Blinks detected in lid closure."""
        assert self.lid is not None
        return detect_blinks(self.lid, self.fps, self.valid)


def behaviour(
    fps: float,
    fields: Mapping[str, ndarray],
    valid: ndarray | None = None,
    annotation: Annotation | None = None,
    reference: Behaviour | None = None,
) -> Behaviour:
    """Behaviour of the fields that are given.

    Raises InputError for missing fields, a wrong shape, a wrong frame rate, a motion that is too short or without valid
    frames.
    """
    known = {name: np.asarray(fields[name], np.float64) for name in FIELDS if name in fields}
    if not known:
        raise InputError(f"motion: should have one of {', '.join(FIELDS)}, got {', '.join(fields) or 'none'}")
    frames = len(next(iter(known.values())))
    for name, array in known.items():
        if array.shape != (frames, *FIELDS[name]):
            raise InputError(f"{name}: should have shape {(frames, *FIELDS[name])}, got {array.shape}")
    if not (np.isfinite(fps) and fps > 0 and frames >= MIN_DURATION_S * fps):
        raise InputError(
            f"motion: should last at least {MIN_DURATION_S:g} s, got {frames} frames at {fps:g} frames per second"
        )
    good = np.ones(frames, bool) if valid is None else np.asarray(valid, bool).copy()
    if good.shape != (frames,):
        raise InputError(f"valid: should have shape {(frames,)}, got {good.shape}")
    for array in known.values():
        good &= np.isfinite(array.reshape(frames, -1)).all(axis=1)
    if not good.any():
        raise InputError("motion: should have a valid frame, got none")
    filled = {name: array if good.all() else array[_nearest(good)] for name, array in known.items()}
    return Behaviour(fps, filled.get("head"), filled.get("gaze"), filled.get("lid"), good, annotation, reference)


def still_motions() -> list[Behaviour]:
    """Three motions of three seconds that do not move, with everything that a metric can need."""
    head, gaze, lid = np.zeros((75, 3)), np.zeros((75, 2, 3)), np.zeros((75, 2))
    one = behaviour(25.0, {"head": head, "gaze": gaze, "lid": lid}, None, Annotation())
    whole = replace(one, reference=one, features=np.zeros((1, 1)), corr=np.zeros((3, 2)))
    return [replace(whole, head=head + turn, gaze=gaze + turn) for turn in (0.0, 0.1, 0.2)]


def with_references(takes: Sequence[Behaviour]) -> list[Behaviour]:
    """Each take with the next one as its reference; a single take has no reference."""
    if len(takes) < 2:
        return list(takes)
    return [replace(take, reference=takes[(index + 1) % len(takes)]) for index, take in enumerate(takes)]


def _nearest(good: Bool[ndarray, " T"]) -> Int[ndarray, " T"]:
    """Index of the last valid frame up to each frame; the first valid frame for those before it."""
    last = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
    return np.asarray(np.where(last < 0, int(np.argmax(good)), last))


def _speed_deg_s(unit: Float[ndarray, "T 2 3"], fps: float) -> Float[ndarray, " F"]:
    return np.asarray(angle_between_deg(unit[:-1], unit[1:]).mean(axis=-1) * fps)
