"""Eye contact, a state and a target in a stream: gaze and head are directed frame by frame, without later frames.

What gaze goes to is the model's own gaze, a target, or a fixation of the model that eye contact has moved. When that
changes, gaze makes one saccade of the main sequence to it and then follows; vergence has a time constant of 0.2 s, and
the head takes its part with minimum jerk, as in files (`steps/target_following.py`, `steps/eye_contact.py`).

Eye contact: a file ranks its fixations by their distance from the listener. A stream knows only the fixations so far,
so a new one is contact if it is nearer than the quantile `eye_contact` of the distances in the last minute, of which
the first are assumed; contact that was missed so far raises the quantile. A saccade of the model is held back until it
has landed, one to three frames, and is then made to where the fixation has been moved.

A state (`steps/states.py` has the figures) is a share of eye contact with a cause of aversions, and scanning saccades
in long fixations; a fixation that outlasts an aversion is decided anew. The head moves less while thinking, which is a
factor on its liveliness (`streaming.py`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.conversation_states import STATES
from talkingeyes.animation.gaze_trajectory import MIN_STEP_RAD, GazeTrajectory, main_sequence_saccade
from talkingeyes.animation.steps import eye_contact as contact
from talkingeyes.animation.steps.states import (
    AVERTING,
    LISTENING_CONTACT,
    LONG_FIXATION_S,
    MIN_SCAN_S,
    SCAN_STREAM,
    THINKING_HEAD,
    sample_scans_rad,
)
from talkingeyes.animation.steps.target_following import HEAD_LAG_S, target_head_contribution_rad
from talkingeyes.animation.targets import STRAIGHT_AHEAD
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import HeadMovement, Saccade
from talkingeyes.head.eyelid.gaze_controller import homogeneous
from talkingeyes.physiology import eye_head, saccades
from talkingeyes.physiology.vergence import TIME_CONSTANT_S
from talkingeyes.synthesis.gaze_aversion import AversionCause
from talkingeyes.synthesis.gaze_shifts import SCAN_MEDIAN_S, SCAN_SPREAD

SACCADE_RAD_S = float(np.radians(25.0))  # faster gaze of the model is a saccade
MAX_HELD_FRAMES = 5
HISTORY_S = 60.0
BALANCE_S = 5.0  # missed contact of this length raises the quantile by 1
MAX_SCAN_S = 2.5  # a scan comes at the latest then; talkers dwell for 3.1 s in the mean (Lee et al. 2002)
# Distances assumed before any were seen: those of a normal distribution about the partner, as of ten seconds.
PRIOR_RAD = np.radians(6.0) * np.sqrt(-2.0 * np.log(1.0 - (np.arange(250) + 0.5) / 250))

Key = tuple[object, ...]
MODEL: Key = ("model",)


@dataclass(frozen=True)
class GazeDirection:
    """What directs gaze: a state, the share of time at the listener, a target in metres; each precedes those before.

    Raises InputError for an unknown state.
    """

    eye_contact: float | None = None
    target_m: tuple[float, float, float] | None = None
    state: str | None = None

    def __post_init__(self) -> None:
        if self.state is not None and self.state not in STATES:
            raise InputError(f"state: should be one of {', '.join(STATES)}, got {self.state}")

    @property
    def contact(self) -> Contact | None:
        """Eye contact as it was set, or that of the state."""
        if self.eye_contact is not None:
            return Contact(self.eye_contact)
        if self.state == "listening":
            return Contact(LISTENING_CONTACT)
        return next((Contact(*rule[:2]) for state, rule in AVERTING.items() if state == self.state), None)

    @property
    def scans(self) -> bool:
        """Whether long fixations get scanning saccades."""
        return self.state not in (None, "speaking")

    @property
    def head_gain(self) -> float:
        """Factor on the motion of the head."""
        return THINKING_HEAD if self.state == "thinking" else 1.0

    @property
    def is_free(self) -> bool:
        """Whether gaze is the model's own."""
        return self.contact is None and self.target_m is None


@dataclass(frozen=True)
class Contact:
    """The share of time at the listener, and why gaze is averted else."""

    share: float
    cause: AversionCause = "intimacy"


@dataclass(frozen=True)
class _Plan:
    """What gaze goes to: its name, the part of the head (yaw, pitch), and whether gaze waits for a saccade."""

    key: Key
    head_rad: Float[ndarray, " 2"]
    waits: bool = False


@dataclass(frozen=True)
class _Shift:
    """The saccade to the current goal, and half of the vergence before it."""

    saccade: Saccade
    half_vergence_rad: Float[ndarray, " 2"]


def listener_offsets(head: Float[ndarray, "T 3"], gaze_in_space_rad: Float[ndarray, "T 2 2"]) -> Float[ndarray, "T 2"]:
    """From the listener to the model's line of sight in each frame."""
    listener = STRAIGHT_AHEAD.at(np.zeros(len(head)))
    sight = line_of_sight.cyclopean_line_of_sight_rad(gaze_in_space_rad)
    return np.asarray(sight - line_of_sight.target_direction_rad(head, listener))


class LiveGaze:
    """Directs the frames of one stream, in order; `mean_head` is the model's mean pose."""

    def __init__(self, fps: float, mean_head: Float[ndarray, " 3"], seeds: list[int]) -> None:
        self._fps, self._rng = fps, np.random.default_rng(seeds)
        self._pointing_rad = rotation.direction_to_angles(rotation.rotvec_to_direction(mean_head))
        self._distances = deque(PRIOR_RAD.tolist(), maxlen=round(HISTORY_S * fps))
        self._frame = 0
        self._key = MODEL
        self._shift: _Shift | None = None
        self._own_rad: Float[ndarray, " 2"] | None = None  # the model's gaze in the last frame
        self._shown_rad, self._half_vergence_rad, self._goal_rad = np.zeros(2), np.zeros(2), np.zeros((2, 2))
        self._held_frames = 0
        self._fixation, self._correction_rad = 0, np.zeros(2)
        self._sight_rad, self._missed_s = np.zeros(2), 0.0  # from the listener; contact that was missed
        self._away_rad, self._away_until_s, self._cause = np.zeros(2), -np.inf, ""
        self._scan_gain, self._scan_rng = 1.0, np.random.default_rng([*seeds, SCAN_STREAM])
        self._scan_rad, self._scans, self._scan_s, self._decided_s = np.zeros(2), 0, np.inf, -np.inf
        self._head_rad, self._head_goal_rad = np.zeros(2), np.zeros(2)  # what completed movements added, and the goal
        self._moves: list[HeadMovement] = []

    def direct(
        self,
        trajectory: GazeTrajectory,
        direction: GazeDirection,
        liveliness: float = 1.0,
        listening: Sequence[float | None] = (),
        offsets_rad: Float[ndarray, "T 2"] | None = None,
    ) -> GazeTrajectory:
        """The next frames, directed; they are unchanged while nothing directs gaze or did shortly before.

        `liveliness` of gaze scales scanning saccades. `listening`: eye contact of a listener in each frame
        (`live_listening.py`), which applies where nothing else directs gaze. `offsets_rad`: `listener_offsets` of these
        frames, which cost less for many streams together.
        """
        self._scan_gain = liveliness
        if offsets_rad is None:
            offsets_rad = listener_offsets(trajectory.head, trajectory.gaze_in_space_rad)
        head, space = trajectory.head.copy(), trajectory.gaze_in_space_rad.copy()
        for frame, offset in enumerate(offsets_rad):
            self._distances.append(float(np.hypot(*offset)))
            contact_share = listening[frame] if listening and direction.state is None and direction.is_free else None
            wanted = direction if contact_share is None else GazeDirection(contact_share)
            head[frame], space[frame] = self._directed(head[frame], space[frame], offset, wanted)
        return replace(trajectory, head=head, gaze_in_space_rad=space)

    def _directed(
        self,
        head: Float[ndarray, " 3"],
        space_rad: Float[ndarray, "2 2"],
        offset_rad: Float[ndarray, " 2"],
        direction: GazeDirection,
    ) -> tuple[Float[ndarray, " 3"], Float[ndarray, "2 2"]]:
        """Head and gaze of the next frame."""
        own_rad, time_s, first = space_rad.mean(axis=0), self._frame / self._fps, self._own_rad is None
        landed = self._landed(own_rad)
        self._own_rad, self._frame = own_rad, self._frame + 1
        if not (direction.is_free and self._key == MODEL and self._shift is None and not self._moves):
            plan = self._plan(direction, offset_rad, landed, time_s)
            onset_s = time_s - 1.0 / self._fps  # the first frame of a shift has moved
            changed, self._key = plan.key != self._key, plan.key
            if changed:
                self._turn_head(plan.head_rad, -1.0 if first else onset_s + HEAD_LAG_S)
            head = self._turned(head, time_s)
            goal_rad = self._goal_rad if plan.waits else self._goal(head, space_rad, direction)
            if changed and not first:
                jump = main_sequence_saccade(onset_s, self._shown_rad, goal_rad.mean(axis=0) - self._shown_rad)
                self._shift = _Shift(jump, self._half_vergence_rad)
            space_rad, self._goal_rad = self._shifted(goal_rad, time_s), goal_rad
        self._shown_rad, self._half_vergence_rad = space_rad.mean(axis=0), (space_rad[0] - space_rad[1]) / 2.0
        self._sight_rad = offset_rad + self._shown_rad - own_rad
        return head, space_rad

    def _landed(self, own_rad: Float[ndarray, " 2"]) -> bool:
        """Whether the model's gaze is in a fixation; the first frame after a saccade begins a new one."""
        step = 0.0 if self._own_rad is None else float(np.hypot(*(own_rad - self._own_rad)))
        if step * self._fps > SACCADE_RAD_S and self._held_frames < MAX_HELD_FRAMES:
            self._held_frames += 1
            return False
        self._fixation += self._held_frames > 0
        self._held_frames = 0
        return True

    def _plan(self, direction: GazeDirection, offset_rad: Float[ndarray, " 2"], landed: bool, time_s: float) -> _Plan:
        """What gaze goes to in this frame."""
        if direction.target_m is not None:
            targets = homogeneous(np.array([direction.target_m]))
            return _Plan(("target", direction.target_m), target_head_contribution_rad(targets, self._pointing_rad)[0])
        wanted = direction.contact
        if wanted is None:
            return _Plan(MODEL, np.zeros(2))
        self._count_missed(wanted)
        if not landed and self._key[:1] == (wanted,):
            return _Plan(self._key, self._head_goal_rad, waits=True)
        is_new = self._key[:2] != (wanted, self._fixation)
        scans = not is_new and direction.scans and time_s >= self._scan_s
        if is_new or scans:
            self._scan(scans, time_s)
        if is_new or (scans and time_s >= self._decided_s + contact.AVERSION_S):
            self._correction_rad, self._decided_s = self._correction(offset_rad, wanted, time_s), time_s
        level = eye_head.head_contribution(self._correction_rad, contact.HEAD_THRESHOLD_RAD, contact.HEAD_GAIN)
        return _Plan((wanted, self._fixation, self._scans), level)

    def _count_missed(self, wanted: Contact) -> None:
        """Add what the last frame missed of eye contact, since it was last changed."""
        in_contact = np.hypot(*self._sight_rad) < contact.CONTACT_RAD
        self._missed_s += (wanted.share - in_contact) / self._fps
        if self._key[:1] != (wanted,):
            self._missed_s = 0.0

    def _scan(self, scans: bool, time_s: float) -> None:
        """Begin a fixation, or scan within it, and say when the next scan is due."""
        dwell_s = SCAN_MEDIAN_S * self._scan_rng.lognormal(0.0, SCAN_SPREAD)
        self._scan_s = time_s + float(np.clip(dwell_s, MIN_SCAN_S if scans else LONG_FIXATION_S, MAX_SCAN_S))
        self._scan_rad = self._scan_gain * sample_scans_rad(self._scan_rng, 1)[0] if scans else np.zeros(2)
        self._scans += scans

    def _is_near(self, near: float, share: float) -> bool:
        """Whether a share of the distances in the last minute is greater; equal distances are in random order."""
        distances = np.array(self._distances)
        rank = np.mean(distances < near) + self._rng.random() * np.mean(distances == near)
        return bool(rank < share)

    def _correction(self, offset_rad: Float[ndarray, " 2"], wanted: Contact, time_s: float) -> Float[ndarray, " 2"]:
        """What is added to a fixation of the model, so that it is contact or averted."""
        near = float(np.hypot(*offset_rad))
        if self._is_near(near, float(np.clip(wanted.share + self._missed_s / BALANCE_S, 0.0, 1.0))):
            self._away_until_s = -np.inf
            if near <= contact.NEAR_RAD:
                return np.zeros(2)
            return np.asarray(contact.sample_within_face_rad(self._rng) - offset_rad)
        if near >= contact.FAR_RAD:
            return np.zeros(2)
        if time_s > self._away_until_s or wanted.cause != self._cause:
            self._away_rad = contact.sample_aversion_rad(self._rng, wanted.cause)
            self._away_until_s, self._cause = time_s + contact.AVERSION_S, wanted.cause
        # Scanning within the face becomes scanning about the new location, unless that would lead back to the face.
        back = np.hypot(*(self._away_rad + offset_rad)) < contact.FAR_RAD
        return np.asarray(self._away_rad - offset_rad if back else self._away_rad)

    def _turn_head(self, goal_rad: Float[ndarray, " 2"], onset_s: float) -> None:
        """Add the movement from the last goal of the head to a new one."""
        step, self._head_goal_rad = goal_rad - self._head_goal_rad, goal_rad
        if (size := float(np.hypot(*step))) > MIN_STEP_RAD:
            duration = float(eye_head.head_duration_s(size))
            self._moves.append(HeadMovement(onset_s, duration, (float(step[0]), float(step[1]), 0.0)))

    def _turned(self, head: Float[ndarray, " 3"], time_s: float) -> Float[ndarray, " 3"]:
        """The head with the movements so far; those that are complete are summed up."""
        while self._moves and self._moves[0].onset_s + self._moves[0].duration_s <= time_s:
            self._head_rad = self._head_rad + self._moves.pop(0).delta_rad[:2]
        yaw, pitch = self._head_rad + eye_head.head_path(self._moves, np.array([time_s]))[0, :2]
        return np.asarray(head + np.array([-pitch, yaw, 0.0]))

    def _goal(
        self, head: Float[ndarray, " 3"], space_rad: Float[ndarray, "2 2"], direction: GazeDirection
    ) -> Float[ndarray, "2 2"]:
        """Where both eyes go."""
        if direction.target_m is not None:
            targets = homogeneous(np.array([direction.target_m]))
            return np.asarray(line_of_sight.optical_axes_rad(head[None], targets, "world")[0])
        return space_rad if direction.contact is None else space_rad + self._correction_rad + self._scan_rad

    def _shifted(self, goal_rad: Float[ndarray, "2 2"], time_s: float) -> Float[ndarray, "2 2"]:
        """Gaze of both eyes: in the shift to the goal, or at it."""
        if self._shift is None:
            return goal_rad
        jump, elapsed_s = self._shift.saccade, time_s - self._shift.saccade.onset_s
        done = float(saccades.completed_fraction(np.array(elapsed_s / jump.duration_s), jump.skew))
        left = float(np.exp(-elapsed_s / TIME_CONSTANT_S))
        goal, goal_half = goal_rad.mean(axis=0), (goal_rad[0] - goal_rad[1]) / 2.0
        cyclopean = jump.start_rad + done * (goal - jump.start_rad)
        half = goal_half + left * (self._shift.half_vergence_rad - goal_half)
        if done == 1.0 and left < 1e-3:
            self._shift = None
        return np.stack([cyclopean + half, cyclopean - half])
