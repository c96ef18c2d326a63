"""Gaze of a person of a recorded population: fixation after fixation, with the cues of speech on top.

How long a fixation lasts, whether the next one is at the partner, and where it is follow the person's habits by state
of the conversation (physiology/gaze_population.py). The recordings leave out the first and the last seconds of each
turn and say nothing about hesitations, so looking away and back there follows the cues from the literature
(gaze_aversion.py): gaze leaves the partner when the interval of a cue starts, stays away until its end, and returns.
"""

from __future__ import annotations

import numpy as np

from talkingeyes.audio.annotation import Annotation
from talkingeyes.physiology.gaze_population import GazeHabits, State
from talkingeyes.synthesis.gaze_aversion import WARM_UP_S, GazeCues, GazeInterval, listens, sample_gaze_cues
from talkingeyes.synthesis.gaze_shifts import MIN_INTERSACCADIC_S, GazeBuilder


def generate_fixations(
    gaze_builder: GazeBuilder, annotation: Annotation, habits: GazeHabits, seconds: float
) -> list[GazeInterval]:
    """Sample gaze from WARM_UP_S before the clip to its end. Returns the gaze states, one after the other."""
    rng, style = gaze_builder.rng, gaze_builder.style
    cues = sample_gaze_cues(annotation, style, rng)
    time_s, away = -WARM_UP_S, bool(rng.random() > style.partner_gaze_speaking)
    starts_s: list[float] = []
    aversions: list[bool] = []
    while time_s < seconds:
        state: State = "listening" if listens(annotation.listening, time_s) else "speaking"
        how, share = habits.states[state], getattr(style, f"partner_gaze_{state}")
        present_deg = np.degrees(gaze_builder.gaze_rad - gaze_builder.partner_rad)
        target_rad = gaze_builder.partner_rad + np.radians(how.place_deg(away, present_deg, rng))
        if aversions and aversions[-1] == away:
            gaze_builder.shift(time_s, target_rad)
        else:
            # The end is not known yet, so the head goes back with the gaze, not before.
            gaze_builder.enter_interval(GazeInterval(time_s, time_s, away), target_rad)
            starts_s.append(time_s)
            aversions.append(away)
        begun_s = gaze_builder.earliest_onset_s - MIN_INTERSACCADIC_S
        end_s = max(begun_s + how.dwell_s(away, rng) / style.liveliness, gaze_builder.earliest_onset_s)
        time_s, cued = _cued_end(cues, begun_s, end_s, away)
        away = how.looks_away_next(away, share, rng) if cued is None else cued
    ends_s = [*starts_s[1:], max(time_s, seconds)]
    return [GazeInterval(*each) for each in zip(starts_s, ends_s, aversions, strict=True)]


def _cued_end(cues: GazeCues, begun_s: float, end_s: float, away: bool) -> tuple[float, bool | None]:
    """End of a fixation, and whether a cue sends the next one away (None: no cue says so)."""
    if away:
        within = [interval for interval in cues.aversions if interval.start_s <= begun_s < interval.end_s]
        back_s = [*cues.returns_s, *(interval.end_s for interval in within)]
        if earlier := [each for each in back_s if begun_s < each <= end_s]:
            return max(min(earlier), begun_s + MIN_INTERSACCADIC_S), False
        return end_s, True if within else None
    for interval in cues.aversions:
        if begun_s < interval.start_s <= end_s:
            return max(interval.start_s, begun_s + MIN_INTERSACCADIC_S), True
        if interval.start_s <= begun_s < interval.end_s - MIN_INTERSACCADIC_S:
            return end_s, True
    return end_s, None
