"""The same figures of recorded people, as far as a recording holds them.

Eye tracking (Andersson et al. 2017: 500 Hz, pictures and films, chin rest) tells of saccades; tables of faces in video
(OpenFace) of heads and, roughly, of eyes; fixations in conversation (Dembinsky et al. 2024) of how far gaze goes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from talkingeyes.core import rotation
from talkingeyes.corpus.recordings_of_people import ConversationFixations, Recording
from talkingeyes.evaluation.benchmark.behaviour import Behaviour, behaviour
from talkingeyes.evaluation.facts import figures, saccades
from talkingeyes.evaluation.facts.clip import Pool, Seen, joined
from talkingeyes.evaluation.facts.figures import Figures

OF_TRACKING = ("below_5", "below_15", "amplitude", "cardinal", "rate", "psd_gaze")
OF_RATES = ("largest", "vmax", "constant", "slope_10", "slope_40", "duration_slope", "duration_intercept", "shape")
OF_VIDEO = (
    "eye_yaw",
    "eye_pitch",
    "vor_yaw",
    "vor_pitch",
    "speed",
    "head_yaw",
    "head_pitch",
    "head_roll",
    "head_fast",
    "psd_head",
)
VIDEO_FPS = 45.0  # slower than this: frame rates that compare with 25


def behaviour_of(recording: Recording) -> Behaviour:
    """Both eyes parallel, no lids, no speech."""
    eye = rotation.eye_in_head(recording.head, recording.gaze_in_space_rad[:, None])
    fields = {"head": recording.head, "gaze": np.repeat(eye, 2, axis=1)}
    return behaviour(recording.fps, fields, recording.valid)


def of_tracking(recordings: Sequence[Recording]) -> Figures:
    """Of eye tracking at 500 Hz; what the corpus shows at 25 frames a second is read from one sample in twenty."""
    fast = joined(_rates(each) for each in recordings)
    found = figures.of_gaze(tracking_pool(recordings)) | figures.of_rates(fast)
    return {name: found[name] for name in (*OF_TRACKING, *OF_RATES)}


def tracking_pool(recordings: Sequence[Recording]) -> Pool:
    """One sample in twenty, as frames."""
    return joined(figures.observe(Seen("", "", behaviour_of(each.every(20)))) for each in recordings)


def _rates(recording: Recording) -> Pool:
    fine, coarse = behaviour_of(recording), behaviour_of(recording.every(20))
    return saccades.of_rate("at500", fine, fine.saccades) | saccades.same("same25", fine.saccades, coarse.saccades)


def of_video(recordings: Sequence[Recording]) -> Figures:
    """Of faces in video."""
    slow = [each for each in recordings if each.fps < VIDEO_FPS]
    pool = joined(figures.observe(Seen("", "", behaviour_of(each))) for each in slow)
    found = figures.of_gaze(pool) | figures.of_head(pool) if pool else {}
    return {name: found[name] for name in OF_VIDEO if name in found}


def of_conversation(fixations: ConversationFixations) -> Figures:
    """Steps from fixation to fixation while speaking."""
    pool = conversation_pool(fixations)
    return {
        "below_5": saccades.share_below(pool, 5.0),
        "below_15": saccades.share_below(pool, 15.0),
        "amplitude": saccades.mean_amplitude(pool),
        "cardinal": saccades.cardinal(pool),
    }


def conversation_pool(fixations: ConversationFixations) -> Pool:
    """Steps of a degree or more of all people, as saccades."""
    people = [fixations.of(person, "SPEAK") for person in sorted(set(fixations.person))]
    steps = np.concatenate([each.steps_deg for each in people])
    steps = steps[np.hypot(*steps.T) >= saccades.LEAST_DEG]
    return {
        "saccade.amplitude_deg": np.hypot(*steps.T),
        "saccade.direction_rad": np.arctan2(steps[:, 1], steps[:, 0]),
    }
