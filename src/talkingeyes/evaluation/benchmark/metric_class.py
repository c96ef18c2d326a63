"""What makes the value of each metric in samples of the default model: learning, a correction, rules, or construction.

The classes are of `talkingeyes_events` as the stage `sample` writes it, without the rule-based layers of
animation/steps/. A metric that is not named here is learnt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.measures.metric import Metric

MetricClass = Literal["learnt", "corrected", "rule", "construction"]
LEARNT: Final = "learnt"


@dataclass(frozen=True)
class Origin:
    """A class other than learnt, the code that sets the value, and the metrics."""

    metric_class: MetricClass
    code: str
    metrics: tuple[str, ...]


ORIGINS = (
    Origin(
        "construction",
        "models/gaze/saccade_rendering.py: saccades follow the main sequence",
        ("main_sequence/peak_speed_ratio", "main_sequence/slope", "main_sequence/log_spread", "saccades/duration"),
    ),
    Origin(
        "construction",
        "models/gaze/saccade_rendering.py: eyes turn together, against the head between saccades, without torsion",
        ("eye/torsion", "eye/conjugacy", "head_eye/slope_yaw", "head_eye/slope_pitch", "head_eye/correlation"),
    ),
    Origin(
        "construction",
        "models/gaze/point_process.py, normalise_by: centred at the mean vergence of the training data",
        ("eye/vergence",),
    ),
    Origin(
        "rule",
        "physiology/blinks.py: blinks are sampled at published rates",
        (
            "blinks/rate",
            "blinks/duration_median",
            "blinks/duration_distance",
            "blinks/depth",
            "blinks/interval_cv",
            "blinks/at_shifts",
            "blinks/at_phrase_ends",
        ),
    ),
    Origin(
        "corrected",
        "gaze.observation_noise_deg: the fit's noise is subtracted from the variances of landings",
        (
            "saccades/amplitude",
            "saccades/amplitude_median",
            "saccades/amplitude_p90",
            "saccades/below_5",
            "saccades/below_15",
            "saccades/amplitude_distance",
            "saccades/cardinal_ratio",
        ),
    ),
    Origin(
        "corrected",
        "models/layers/equaliser.py: heads get the spectrum of fitted heads, and eyes turn against the head",
        (
            "head/speed",
            "head/speed_p99",
            "head/speed_distance",
            "head/spectrum_slope",
            "head/above_5_hz",
            "head/spectrum_distance",
            "head/sd_pitch",
            "head/sd_yaw",
            "head/sd_roll",
            "samples/diversity_head",
            "eye/still_fraction",
            "eye/speed",
        ),
    ),
    Origin(
        "corrected",
        "gaze.guidance: what speech adds to the probabilities of where gaze lands is strengthened in sampling",
        (
            "partner_gaze/fraction",
            "partner_gaze/aversion_rate",
            "partner_gaze/aversion_median",
            "partner_gaze/aversion_distance",
            "partner_gaze/dwell_distance",
            "speech_onset/averted",
            "speech_onset/rise",
            "speech_onset/drop",
            "speech_onset/shape",
            "speech_offset/averted",
            "speech_offset/rise",
            "speech_offset/shape",
            "turn_start/rise",
            "turn_start/shape",
            "turn_end/rise",
            "turn_end/shape",
            "hesitation/rise",
            "hesitation/shape",
            "filler/rise",
            "corr/gaze",
            "corr/gaze_minus_shuffled",
            "corr/gaze_in_space",
            "corr/gaze_in_space_minus_shuffled",
        ),
    ),
    Origin(
        "corrected",
        "embedding_scale.head: the speaker's embedding is scaled",
        ("reference_correlation/head_pitch", "reference_correlation/head_yaw", "reference_correlation/head_roll"),
    ),
)
_ORIGIN = {metric: origin for origin in ORIGINS for metric in origin.metrics}


def class_of(metric: str) -> MetricClass:
    """Class of a metric, by its name."""
    return _ORIGIN[metric].metric_class if metric in _ORIGIN else LEARNT


def code_of(metric: str) -> str:
    """The code that sets the value of a metric that is not learnt; else empty."""
    return _ORIGIN[metric].code if metric in _ORIGIN else ""


@dataclass(frozen=True)
class LearntCount:
    """Learnt metrics that are worse than the truth by more than the interval, of those that are compared."""

    worse: int
    compared: int


def count_learnt(rows: Sequence[MetricResult], missing: Sequence[Metric] = ()) -> LearntCount:
    """Count the learnt metrics of a table; those that are missing in the motions alone count as worse."""
    known = [row.worse for row in rows if row.worse is not None and class_of(row.metric.name) == LEARNT]
    also = sum(class_of(metric.name) == LEARNT for metric in missing)
    return LearntCount(sum(known) + also, len(known) + also)
