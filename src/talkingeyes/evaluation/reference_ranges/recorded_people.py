"""The same statistics of recorded people, as far as the recordings contain the data.

Eye tracking (Andersson et al. 2017: 500 Hz, pictures and films, chin rest) gives saccades; OpenFace tables of faces in
video give head pose and, less accurately, eye angles; fixations in conversation (Dembinsky et al. 2024) give
amplitudes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from talkingeyes.core import rotation
from talkingeyes.corpus.gaze_datasets import ConversationFixations, GazeRecording
from talkingeyes.evaluation.detectors.behaviour import Behaviour, behaviour
from talkingeyes.evaluation.measures import saccades
from talkingeyes.evaluation.measures.pooled import ClipData, PooledArrays, join_pools
from talkingeyes.evaluation.reference_ranges import measurements
from talkingeyes.evaluation.reference_ranges.measurements import Measurements

EYE_TRACKING_STATISTICS = ("below_5", "below_15", "amplitude", "cardinal", "rate", "psd_gaze")
MAIN_SEQUENCE_STATISTICS = (
    "largest",
    "vmax",
    "main_sequence_constant",
    "slope_10",
    "slope_40",
    "duration_slope",
    "duration_intercept",
    "peak_shape",
)
VIDEO_STATISTICS = (
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
MAX_VIDEO_FPS = 45.0  # recordings below this rate are comparable with 25 fps


def behaviour_of(recording: GazeRecording) -> Behaviour:
    """Behaviour of a recording: both eyes parallel, no lids, no speech."""
    eye = rotation.eye_in_head(recording.head, recording.gaze_in_space_rad[:, None])
    fields = {"head": recording.head, "gaze": np.repeat(eye, 2, axis=1)}
    return behaviour(recording.fps, fields, recording.valid)


def measure_eye_tracking(recordings: Sequence[GazeRecording]) -> Measurements:
    """Statistics of eye tracking at 500 Hz; those that a corpus has at 25 frames per second use every 20th sample."""
    fast = join_pools(_rates(each) for each in recordings)
    found = measurements.measure_gaze(tracking_pool(recordings)) | measurements.measure_main_sequence(fast)
    return {name: found[name] for name in (*EYE_TRACKING_STATISTICS, *MAIN_SEQUENCE_STATISTICS)}


def tracking_pool(recordings: Sequence[GazeRecording]) -> PooledArrays:
    """Pool of the recordings with every 20th sample as a frame."""
    return join_pools(measurements.extract(ClipData("", behaviour_of(each.subsample(20)))) for each in recordings)


def _rates(recording: GazeRecording) -> PooledArrays:
    fine, coarse = behaviour_of(recording), behaviour_of(recording.subsample(20))
    return saccades.extract_at_rate("at500", fine, fine.saccades) | saccades.match_frame_rates(
        "same25", fine.saccades, coarse.saccades
    )


def measure_video(recordings: Sequence[GazeRecording]) -> Measurements:
    """Statistics of faces in video, of the recordings below MAX_VIDEO_FPS."""
    slow = [each for each in recordings if each.fps < MAX_VIDEO_FPS]
    pool = join_pools(measurements.extract(ClipData("", behaviour_of(each))) for each in slow)
    found = measurements.measure_gaze(pool) | measurements.measure_head(pool) if pool else {}
    return {name: found[name] for name in VIDEO_STATISTICS if name in found}


def measure_conversation(fixations: ConversationFixations) -> Measurements:
    """Statistics of the steps between fixations while speaking."""
    pool = conversation_pool(fixations)
    return {
        "below_5": saccades.fraction_below(pool, 5.0),
        "below_15": saccades.fraction_below(pool, 15.0),
        "amplitude": saccades.mean_amplitude(pool),
        "cardinal": saccades.cardinal_ratio(pool),
    }


def conversation_pool(fixations: ConversationFixations) -> PooledArrays:
    """Steps of at least a degree of all people, as saccades."""
    people = [fixations.of(person, "SPEAK") for person in sorted(set(fixations.person))]
    steps = np.concatenate([each.gaze_shifts_deg for each in people])
    steps = steps[np.hypot(*steps.T) >= saccades.MIN_AMPLITUDE_DEG]
    return {
        "saccade.amplitude_deg": np.hypot(*steps.T),
        "saccade.direction_rad": np.arctan2(steps[:, 1], steps[:, 0]),
    }
