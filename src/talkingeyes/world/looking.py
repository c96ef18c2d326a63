"""Where gaze goes: saccades between the partner's face and places away from it, and the head that goes along.

Gaze is made in space as a chain of saccades. Inside a state it scans: over the partner's face in small steps, around
the place of looking away by Eyes Alive's law. Large shifts fall short and are corrected (FACTS, section 1), and take
the head along beyond the speaker's threshold (section 2). Angles are (yaw, pitch) in radians, times seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.motion import HeadMove, Saccade
from talkingeyes.physiology import eye_head, saccades
from talkingeyes.world.conversation import Look
from talkingeyes.world.speakers import Style

PARTNER_SPREAD_RAD = np.radians([1.5, 0.8])
FACE_RAD = np.radians([3.2, 3.4])
SCAN_CAP_DEG = {False: 8.0, True: 8.0}
SCAN_MEDIAN_S, SCAN_SPREAD = 0.65, 0.6
LEAST_INTERVAL_S = 0.15
LEAST_AVERSION_DEG = 4.0
LONGEST_RAD = np.radians(27.5)
AWAY_RAD = np.radians(10.0)
EYE_RANGE_RAD = np.radians([[-25.0, -22.0], [25.0, 14.0]])
SPACE_RANGE_RAD = np.radians([[-27.0, -18.0], [27.0, 15.0]])
UNDERSHOOT, UNDERSHOOT_FROM_RAD = (0.95, 0.04), np.radians(10.0)
AVERSION_HEAD_GAIN, EYES_ONLY, HEAD_COMES_BACK = 0.7, 1 / 3, 0.5
HEAD_LEAST_RAD = np.radians(0.5)


@dataclass
class Looking:
    """Gaze and the head's part in it, built up shift by shift. `head_space_rad` is where the gesturing head points."""

    style: Style
    head_s: Float[ndarray, " T"]
    head_space_rad: Float[ndarray, "T 2"]
    random: np.random.Generator
    partner_rad: Float[ndarray, " 2"]
    gaze_rad: Float[ndarray, " 2"]
    along_rad: Float[ndarray, " 2"] = field(default_factory=lambda: np.zeros(2))
    saccades: list[Saccade] = field(default_factory=list)
    head_moves: list[HeadMove] = field(default_factory=list)

    @property
    def free_s(self) -> float:
        """Before this time no further saccade can start."""
        return self.saccades[-1].onset_s + self.saccades[-1].duration_s + LEAST_INTERVAL_S if self.saccades else -np.inf

    def shift(self, onset_s: float, target_rad: Float[ndarray, " 2"]) -> None:
        """A saccade to a target, as far as eyes and head reach; a long one falls short and is corrected."""
        head = self.along_rad + [np.interp(onset_s + 0.2, self.head_s, angle) for angle in self.head_space_rad.T]
        target = np.clip(np.clip(target_rad, *SPACE_RANGE_RAD), *(head + EYE_RANGE_RAD))
        step = target - self.gaze_rad
        step *= min(1.0, LONGEST_RAD / max(float(np.hypot(*step)), 1e-9))
        aim = self.gaze_rad + step
        if np.hypot(*step) > UNDERSHOOT_FROM_RAD:
            self._saccade(onset_s, self.gaze_rad + step * min(1.0, self.random.normal(*UNDERSHOOT)))
            onset_s = self.free_s + self.random.uniform(0.0, 0.05)
        self._saccade(onset_s, aim)

    def _saccade(self, onset_s: float, target_rad: Float[ndarray, " 2"]) -> None:
        self.saccades.append(saccades.saccade(max(onset_s, self.free_s), self.gaze_rad, target_rad, self.random))
        self.gaze_rad = np.array(self.saccades[-1].end_rad)

    def take_head_along(self, onset_s: float, end_s: float, averted: bool) -> None:
        """The head's share of a shift that was just made: towards what is averted to, or back."""
        onset = onset_s + eye_head.draw_onset_lag_s(self.random)
        if not averted:
            self._turn(onset, -self.random.uniform(0.7, 1.0) * self.along_rad)
            return
        if self.random.random() < EYES_ONLY:
            return
        gain = AVERSION_HEAD_GAIN * self.style.head_gain
        turn = eye_head.head_contribution(self.gaze_rad - self.along_rad, self.style.head_threshold, gain)
        self._turn(onset, turn)
        back_s = onset + self.random.uniform(0.6, 1.5)
        if self.random.random() < HEAD_COMES_BACK and back_s < end_s:
            self._turn(back_s, -self.random.uniform(0.5, 1.0) * self.along_rad, self.random.uniform(1.0, 3.0))

    def _turn(self, onset_s: float, turn_rad: Float[ndarray, " 2"], duration_s: float | None = None) -> None:
        amplitude = float(np.hypot(*turn_rad))
        if amplitude < HEAD_LEAST_RAD:
            return
        self.along_rad = self.along_rad + turn_rad
        duration = float(eye_head.head_duration_s(amplitude)) if duration_s is None else duration_s
        self.head_moves.append(
            HeadMove(float(onset_s), float(duration), (-float(turn_rad[1]), float(turn_rad[0]), 0.0))
        )

    def scan(self, look: Look) -> None:
        """Saccades inside a state until it ends."""
        random = self.random
        while True:
            pause = SCAN_MEDIAN_S / self.style.saccade_rate * np.exp(SCAN_SPREAD * random.standard_normal())
            onset = self.free_s + max(0.0, pause - LEAST_INTERVAL_S)
            if onset > look.end_s - LEAST_INTERVAL_S:
                return
            amplitudes = saccades.draw_amplitudes_rad(8, random, cap_deg=SCAN_CAP_DEG[look.averted])
            targets = self.gaze_rad + amplitudes[:, None] * saccades.draw_directions(8, random)
            self.shift(onset, self._near(targets, look.averted))

    def _near(self, targets: Float[ndarray, "K 2"], averted: bool) -> Float[ndarray, " 2"]:
        """The first candidate that stays where the state wants it: on the face, or off it."""
        away = targets - self.partner_rad
        on_face = np.hypot(*(away / FACE_RAD).T) < 1.0
        fits = np.flatnonzero(~on_face & (np.hypot(*away.T) < AWAY_RAD) if averted else on_face)
        return np.asarray(targets[fits[0]] if len(fits) else self.away_point() if averted else self.face_point())

    def face_point(self) -> Float[ndarray, " 2"]:
        """Somewhere on the partner's face."""
        return np.asarray(self.partner_rad + FACE_RAD * self.random.normal(0.0, 0.4, 2))

    def away_point(self) -> Float[ndarray, " 2"]:
        """Somewhere off it, in Eyes Alive's directions and amplitudes, with the speaker's side and size."""
        amplitude = saccades.draw_amplitudes_rad(1, self.random, least_deg=LEAST_AVERSION_DEG)
        direction = saccades.draw_directions(1, self.random)[0]
        if abs(direction[0]) > abs(direction[1]) and self.random.random() < abs(self.style.side):
            direction[0] = np.copysign(direction[0], self.style.side)
        return np.asarray(self.gaze_rad + self.style.aversion_scale * amplitude * direction)


def look_around(
    states: Sequence[Look],
    style: Style,
    head_s: Float[ndarray, " T"],
    head_space_rad: Float[ndarray, "T 2"],
    random: np.random.Generator,
) -> Looking:
    """Gaze through all states. `head_space_rad` (yaw, pitch) at `head_s` is where the head points without gaze."""
    partner = random.normal(0.0, PARTNER_SPREAD_RAD)
    looking = Looking(style, head_s, head_space_rad, random, partner_rad=partner, gaze_rad=partner)
    for look in states:
        looking.shift(look.start_s, looking.away_point() if look.averted else looking.face_point())
        looking.take_head_along(look.start_s, look.end_s, look.averted)
        looking.scan(look)
    return looking
