"""What makes the value of each reference range in animations of the default model: as `benchmark.metric_class`, but of
whole animations, with the rule-based layers of animation/steps/. A range that is not named here is learnt.
"""

from __future__ import annotations

from talkingeyes.evaluation.benchmark.metric_class import LEARNT, MetricClass

RANGE_CLASSES: dict[MetricClass, tuple[str, ...]] = {
    # models/gaze/saccade_rendering.py: saccades follow the main sequence; eyes turn together, against the head, without
    # torsion, and at the mean vergence of the training data.
    "construction": (
        "vmax",
        "main_sequence_constant",
        "slope_10",
        "slope_40",
        "duration_slope",
        "duration_intercept",
        "peak_shape",
        "peak_5",
        "peak_20",
        "oculomotor_range",
        "conjugacy",
        "torsion",
        "vergence",
        "vor_yaw",
        "vor_pitch",
    ),
    # The fit's noise is subtracted from landings; the equaliser gives heads the spectrum of fitted heads, and eyes turn
    # against the head; the speaker's embedding is scaled; guidance strengthens what speech says about landings.
    "corrected": (
        "partner_gaze",
        "partner_gaze_sd",
        "start_averted",
        "end_looking",
        "aversion_duration",
        "partner_gaze_duration",
        "aversion_lead",
        "aversion_lead_iqr",
        "eye_r2",
        "averted_auc",
        "matching_auc_space",
        "matching_auc_gaze",
        "matching_p_gaze",
        "below_5",
        "below_15",
        "amplitude",
        "cardinal",
        "speed",
        "head_yaw",
        "head_pitch",
        "head_roll",
        "head_speed",
        "head_fast",
        "psd_head",
        "icc_head",
    ),
    # physiology/blinks.py; animation/steps/: amplitude_limit.py, listening.py (partner's turns), head_contribution.py.
    "rule": (
        "largest",
        "head_contribution_10",
        "head_contribution_25",
        "partner_gaze_listening",
        "blink_rate",
        "blink_low",
        "blink_high",
        "blink_cv",
        "blink_length",
        "blink_down",
        "blink_up",
        "blink_faster",
        "phrase_end",
        "gaze_evoked_blinks",
        "icc_blink",
    ),
}
_CLASS = {name: each for each, names in RANGE_CLASSES.items() for name in names}


def range_class(name: str) -> MetricClass:
    """Class of a reference range, by its name."""
    return _CLASS.get(name, LEARNT)
