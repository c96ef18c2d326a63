"""Listening behaviour in a conversation, sampled from the times at which the two speakers have the turn.

The model receives the subject's speech alone; head and gaze during the subject's own silence are learnt (part of the
corpus is turn-taking conversation). The response to the partner is rule-based, with the distributions of the synthetic
data: in the partner's turns looks at the partner and away last as in recorded people of a population, face to face
(away for a quarter of the time) or in a remote call (less than a tenth), and nods answer the partner's phrases. The
starts of turns are left to the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import HeadMovement
from talkingeyes.synthesis import head_gestures
from talkingeyes.synthesis.gaze_aversion import GazeInterval, sample_dwell_s
from talkingeyes.synthesis.speakers import SpeakerStyle, sample_style, with_habits

HABIT_STREAM = 1
FACE_TO_FACE, REMOTE_CALL = POPULATIONS = ("face_to_face", "remote_call")


@dataclass(frozen=True)
class ListeningBehaviour:
    """Looks at the partner and away in the partner's turns, and nods."""

    looks: tuple[GazeInterval, ...]
    nods: tuple[HeadMovement, ...]


class ListeningLooks:
    """Looks at the partner and away of one person who listens, one after the other."""

    def __init__(self, population: str, person: Sequence[int], rng: np.random.Generator) -> None:
        """`person` seeds the habits. Raises InputError for an unknown population."""
        check_population(population)
        habits = np.random.default_rng(person)
        style = sample_style(habits)
        self.style: SpeakerStyle = with_habits(style, population, habits) if population == REMOTE_CALL else style
        self._rng = rng

    def first_averted(self) -> bool:
        """Sample whether gaze is away when a turn of the partner begins."""
        return bool(self._rng.random() > self.style.partner_gaze_listening)

    def dwell_s(self, averted: bool) -> float:
        """Sample the duration of a look away, or of one at the partner."""
        if self.style.habits is None:
            return sample_dwell_s(averted, "listening", self.style, self._rng)
        habits, seconds = self.style.habits.states["listening"], 0.0
        while True:  # fixations, until one goes to the other place
            seconds += habits.dwell_s(averted, self._rng)
            if habits.looks_away_next(averted, habits.partner_share, self._rng) != averted:
                return seconds


def check_population(population: str) -> None:
    """Raises InputError for an unknown population."""
    if population not in POPULATIONS:
        raise InputError(f"population: should be one of {', '.join(POPULATIONS)}, got {population}")


def sample_listening_behaviour(
    turns: Annotation, seeds: Sequence[int], population: str = FACE_TO_FACE, person: Sequence[int] | None = None
) -> ListeningBehaviour:
    """Sample the listening behaviour of one person in a conversation with these turns.

    `person` seeds habits that hold over conversations; None: those of the seeds.
    """
    rng = np.random.default_rng(seeds)
    looking = ListeningLooks(population, [*seeds, HABIT_STREAM] if person is None else person, rng)
    looks = []
    for span in turns.listening:
        time_s, averted = span.start_s, looking.first_averted()
        while time_s < span.end_s:
            end_s = min(span.end_s, time_s + looking.dwell_s(averted))
            looks.append(GazeInterval(time_s, end_s, averted))
            time_s, averted = end_s, not averted
    return ListeningBehaviour(tuple(looks), tuple(head_gestures.listener_nods(turns, looking.style, rng)))
