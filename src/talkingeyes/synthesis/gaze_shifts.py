"""Gaze shifts: saccades between and within the partner's face and averted locations, with head contribution.

Gaze in space is a chain of saccades. Within a state gaze scans: in small steps over the partner's face, or around the
averted location with the amplitude distribution of Eyes Alive. The direction of an aversion depends on its cause
(Andrist et al. 2013), its amplitude is again that of Eyes Alive. Large shifts undershoot and are corrected (Collewijn,
Erkelens & Steinman 1988), and beyond the speaker's threshold the head contributes (Stahl 1999). The partner is at a
fixed distance, averted locations are further away, and the eyes converge accordingly. Angles are (yaw, pitch) in
radians, times in seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.motion import HeadMovement, Saccade, VergenceMovement
from talkingeyes.physiology import eye_head, saccades
from talkingeyes.synthesis.gaze_aversion import AversionCause, GazeInterval
from talkingeyes.synthesis.speakers import SpeakerStyle

# Values without a source are choices of this project.
PARTNER_SPREAD_RAD = np.radians([1.5, 0.8])
PARTNER_DISTANCE_M, AVERSION_DISTANCE_M = (0.8, 1.3), (1.5, 4.0)
FACE_RADIUS_RAD = np.radians([3.2, 3.4])
MAX_SCAN_DEG = {False: 6.0, True: 12.0}
SCAN_MEDIAN_S, SCAN_SPREAD = 0.60, 0.6
MIN_INTERSACCADIC_S = 0.15
MIN_AVERSION_DEG = 4.0
MAX_SHIFT_RAD = np.radians(27.5)
MAX_AVERSION_RAD = np.radians(20.0)
# Leaves room for kappa and vergence, which are added later, within the range of eye_head.
EYE_RANGE_RAD = np.radians([[-23.5, -22.0], [23.5, 14.0]])
SPACE_RANGE_RAD = np.radians([[-27.0, -18.0], [27.0, 15.0]])
UNDERSHOOT, UNDERSHOOT_FROM_RAD = (0.95, 0.04), np.radians(10.0)
HEAD_RETURN_PROBABILITY = 0.5
# The head contributes less to aversions than to looking at objects; a third of them, mostly small, use the eyes alone.
AVERSION_HEAD_GAIN = 0.9
EYES_ONLY_PROBABILITY, EYES_ONLY_FALL_PER_DEG, MIN_EYES_ONLY_PROBABILITY = 0.65, 0.03, 0.10
MIN_HEAD_TURN_RAD = np.radians(0.5)
# Proportions of up, side and down (Andrist et al. 2013), each distributed over its octants as in Eyes Alive.
DIRECTIONS: dict[AversionCause, tuple[float, float, float]] = {
    "planning": (0.39, 0.32, 0.29),
    "floor": (0.21, 0.49, 0.30),
    "intimacy": (0.14, 0.57, 0.29),
}
OCTANTS_UP, OCTANTS_SIDE, OCTANTS_DOWN = (1, 2, 3), (0, 4), (5, 6, 7)


@dataclass
class GazeBuilder:
    """Gaze and head contribution, built shift by shift. `head_space_rad` is the head direction without contribution."""

    style: SpeakerStyle
    head_s: Float[ndarray, " T"]
    head_space_rad: Float[ndarray, "T 2"]
    rng: np.random.Generator
    partner_rad: Float[ndarray, " 2"]
    partner_distance_m: float
    gaze_rad: Float[ndarray, " 2"]
    head_contribution_rad: Float[ndarray, " 2"] = field(default_factory=lambda: np.zeros(2))
    saccades: list[Saccade] = field(default_factory=list)
    head_movements: list[HeadMovement] = field(default_factory=list)
    vergence_movements: list[VergenceMovement] = field(default_factory=list)

    @property
    def earliest_onset_s(self) -> float:
        """Earliest time at which another saccade can start."""
        return (
            self.saccades[-1].onset_s + self.saccades[-1].duration_s + MIN_INTERSACCADIC_S if self.saccades else -np.inf
        )

    def enter_interval(self, interval: GazeInterval, target_rad: Float[ndarray, " 2"]) -> None:
        """Shift gaze to a target, and head contribution and vergence distance to a new state."""
        onset_s = self.shift(interval.start_s, target_rad)
        distance_m = self.rng.uniform(*AVERSION_DISTANCE_M) if interval.averted else self.partner_distance_m
        self.vergence_movements.append(VergenceMovement(onset_s, float(distance_m)))
        self.add_head_contribution(onset_s, interval)

    def shift(self, onset_s: float, target_rad: Float[ndarray, " 2"]) -> float:
        """Add a saccade towards a target within the range of eyes and head; return its onset.

        A large saccade undershoots and is followed by a corrective one.
        """
        onset_s = max(onset_s, self.earliest_onset_s)
        target = np.clip(np.clip(target_rad, *self._range_rad()), *(self.head_at(onset_s + 0.2) + EYE_RANGE_RAD))
        step = target - self.gaze_rad
        step *= min(1.0, MAX_SHIFT_RAD / max(float(np.hypot(*step)), 1e-9))
        aim = self.gaze_rad + step
        if np.hypot(*step) > UNDERSHOOT_FROM_RAD:
            self._saccade(onset_s, self.gaze_rad + step * min(1.0, self.rng.normal(*UNDERSHOOT)))
            self._saccade(self.earliest_onset_s + self.rng.uniform(0.0, 0.05), aim)
        else:
            self._saccade(onset_s, aim)
        return onset_s

    def head_at(self, time_s: float) -> Float[ndarray, " 2"]:
        """Head direction at a time with the current head contribution completed."""
        return np.asarray(
            [np.interp(time_s, self.head_s, angle) for angle in self.head_space_rad.T] + self.head_contribution_rad
        )

    def _range_rad(self) -> Float[ndarray, "2 2"]:
        """Least and largest direction of gaze in space: of a recorded population relative to the partner."""
        if self.style.habits is None:
            return SPACE_RANGE_RAD
        return np.asarray(self.partner_rad + np.radians(self.style.habits.range_deg))

    def _saccade(self, onset_s: float, target_rad: Float[ndarray, " 2"]) -> None:
        self.saccades.append(saccades.sample_saccade(onset_s, self.gaze_rad, target_rad, self.rng))
        self.gaze_rad = np.array(self.saccades[-1].end_rad)

    def add_head_contribution(self, onset_s: float, interval: GazeInterval) -> None:
        """Add the head contribution to a shift that starts at `onset_s`: towards an averted location, or back."""
        onset = onset_s + eye_head.sample_onset_lag_s(self.rng)
        if not interval.averted:
            self._turn(onset, -self.rng.uniform(0.7, 1.0) * self.head_contribution_rad)
            return
        eccentricity = self.gaze_rad - self.head_at(onset_s)
        fall = EYES_ONLY_FALL_PER_DEG * float(np.degrees(np.hypot(*eccentricity)))
        if self.rng.random() < max(MIN_EYES_ONLY_PROBABILITY, EYES_ONLY_PROBABILITY - fall):
            return
        gain = min(1.0, AVERSION_HEAD_GAIN * self.style.head_gain)
        self._turn(onset, eye_head.head_contribution(eccentricity, self.style.head_threshold, gain))
        back_s = onset + self.rng.uniform(0.6, 1.5)
        if self.rng.random() < HEAD_RETURN_PROBABILITY and back_s < interval.end_s:
            self._turn(back_s, -self.rng.uniform(0.5, 1.0) * self.head_contribution_rad, self.rng.uniform(1.0, 3.0))

    def _turn(self, onset_s: float, turn_rad: Float[ndarray, " 2"], duration_s: float | None = None) -> None:
        amplitude = float(np.hypot(*turn_rad))
        if amplitude < MIN_HEAD_TURN_RAD:
            return
        self.head_contribution_rad = self.head_contribution_rad + turn_rad
        duration = float(eye_head.head_duration_s(amplitude)) if duration_s is None else duration_s
        self.head_movements.append(
            HeadMovement(float(onset_s), float(duration), (-float(turn_rad[1]), float(turn_rad[0]), 0.0))
        )

    def scan(self, interval: GazeInterval) -> None:
        """Add saccades within a state until it ends."""
        rng = self.rng
        median_s = SCAN_MEDIAN_S / (self.style.saccade_rate * self.style.liveliness)
        while True:
            onset = self.earliest_onset_s + max(
                0.0, median_s * np.exp(SCAN_SPREAD * rng.standard_normal()) - MIN_INTERSACCADIC_S
            )
            if onset > interval.end_s - MIN_INTERSACCADIC_S:
                return
            amplitudes = saccades.sample_amplitudes_rad(8, rng, max_deg=MAX_SCAN_DEG[interval.averted])
            targets = self.gaze_rad + amplitudes[:, None] * saccades.sample_directions(8, rng)
            self.shift(onset, self._near(targets, interval))

    def _near(self, targets: Float[ndarray, "K 2"], interval: GazeInterval) -> Float[ndarray, " 2"]:
        """The first candidate that is valid in the state: on the partner's face, or off it."""
        away = targets - self.partner_rad
        on_face = np.hypot(*(away / FACE_RADIUS_RAD).T) < 1.0
        off_face = np.hypot(*(away / (1.4 * FACE_RADIUS_RAD)).T) > 1.0
        fits = np.flatnonzero(off_face & (np.hypot(*away.T) < MAX_AVERSION_RAD) if interval.averted else on_face)
        if len(fits):
            return np.asarray(targets[fits[0]])
        return self.aversion_point(interval.cause) if interval.averted else self.point_on_face()

    def point_on_face(self) -> Float[ndarray, " 2"]:
        """Sample a location on the partner's face."""
        return np.asarray(self.partner_rad + FACE_RADIUS_RAD * self.rng.normal(0.0, 0.4, 2))

    def aversion_point(self, cause: AversionCause) -> Float[ndarray, " 2"]:
        """Sample an averted location: direction by cause, preferred side and lowering, amplitude of Eyes Alive."""
        min_deg = max(MIN_AVERSION_DEG, 1.5 * float(np.degrees(FACE_RADIUS_RAD.max())))
        amplitude = saccades.sample_amplitudes_rad(1, self.rng, min_deg=min_deg)
        direction = saccades.sample_directions(1, self.rng, octant_probabilities(cause))[0]
        if abs(direction[0]) > abs(direction[1]) and self.rng.random() < abs(self.style.aversion_side):
            direction[0] = np.copysign(direction[0], self.style.aversion_side)
        size = self.style.aversion_scale * np.sqrt(min(1.0, self.style.liveliness))
        away, lowering = size * amplitude * direction, self.style.aversion_lowering
        if 0.0 < away[1] < 2.0 * lowering:  # lowered, it would be at the partner's face or nearer to it
            away[1] *= -1.0
        return np.asarray(self.partner_rad + away - np.array([0.0, lowering]))


def octant_probabilities(cause: AversionCause) -> Float[ndarray, " 8"]:
    """Probabilities that an aversion goes to 0, 45, ..., 315 degrees (0 to the subject's left, 90 up)."""
    shares = np.zeros(8)
    groups = (OCTANTS_UP, OCTANTS_SIDE, OCTANTS_DOWN)
    for octants, share in zip(groups, DIRECTIONS[cause], strict=True):
        percent = saccades.DIRECTION_PERCENT[list(octants)]
        shares[list(octants)] = share * percent / percent.sum()
    return shares


def start_gaze(
    style: SpeakerStyle, head_s: Float[ndarray, " T"], head_space_rad: Float[ndarray, "T 2"], rng: np.random.Generator
) -> GazeBuilder:
    """Gaze at the partner, whose place is sampled. `head_space_rad` (yaw, pitch) at `head_s`: head without
    contribution."""
    partner = rng.normal(0.0, PARTNER_SPREAD_RAD)
    partner_distance_m = float(rng.uniform(*PARTNER_DISTANCE_M))
    return GazeBuilder(style, head_s, head_space_rad, rng, partner, partner_distance_m, gaze_rad=partner)


def generate_gaze(gaze_builder: GazeBuilder, states: Sequence[GazeInterval]) -> None:
    """Sample gaze through all states."""
    for interval in states:
        target = gaze_builder.aversion_point(interval.cause) if interval.averted else gaze_builder.point_on_face()
        gaze_builder.enter_interval(interval, target)
        gaze_builder.scan(interval)
