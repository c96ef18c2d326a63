"""The table of reference ranges: statistics of eyes, head, lids and jaw in speech, and the range a corpus should meet.

A range tests the data generator; it is not a claim about people. When better evidence is found, the range is changed in
a commit of its own, and the previous one is kept in `previous_range`. Certainty of a source: S* read there or in a
secondary source, S well known, R recalled from the literature, U a prior only, D a choice of this project, M computed
or simulated for it.
"""

from __future__ import annotations

from dataclasses import dataclass

INF = float("inf")


@dataclass(frozen=True)
class ReferenceRange:
    """A statistic with its published values for people, and the inclusive range in which a corpus should lie."""

    name: str
    statistic: str
    published: str
    low: float | int
    high: float | int
    source: str
    unit: str = ""
    previous_range: str = ""

    def contains(self, value: float) -> bool:
        """Whether a value lies in the range."""
        return self.low <= value <= self.high


# Sections of the table, in order: title, ranges.
RANGES_BY_SECTION: dict[str, tuple[ReferenceRange, ...]] = {
    "Saccades": (
        ReferenceRange(
            "below_5", "P(A < 5 deg), gaze in space, A >= 1 deg", "0.50-0.53", 0.42, 0.70, "Malinov 2000 S*, Lee 2002 R"
        ),
        ReferenceRange("below_15", "P(A < 15 deg)", "0.83-0.90", 0.80, 0.98, "Malinov 2000, Bahill 1975"),
        ReferenceRange("amplitude", "mean amplitude", "6-7", 4, 8, "Lee 2002, formula M", "deg"),
        ReferenceRange("largest", "largest amplitude while talking", "27.5", 0, 30, "Lee 2002 R", "deg"),
        ReferenceRange("cardinal", "cardinal / diagonal directions", "2.4", 1.6, 3.0, "Lee 2002 R"),
        ReferenceRange("rate", "saccade rate", "1-2.5", 0.8, 2.8, "U", "1/s"),
        ReferenceRange("vmax", "main sequence, 500 fps: Vmax", "500", 450, 600, "Bahill 1975, Collewijn 1988", "deg/s"),
        ReferenceRange(
            "main_sequence_constant",
            "main sequence, 500 fps: constant c",
            "9-14",
            7.5,
            15,
            "Bahill 1975, Collewijn 1988, M",
            "deg",
            # c increases with the fitted range of amplitudes: the main sequence of physiology/saccades.py has 10.6 over
            # 1 to 40 degrees, 8.9 up to 30 and 8.5 up to 27; speech has no larger saccades (limit 27.5, few above 20).
            previous_range="8 to 15: for a fit up to 40 degrees; over the amplitudes of speech the same curve has 8.5",
        ),
        ReferenceRange("slope_10", "log-log slope, A 0.5-10 deg, 500 fps", "0.79", 0.70, 0.88, "M"),
        ReferenceRange("slope_40", "log-log slope, A 0.5-40 deg, 500 fps", "0.66", 0.58, 0.75, "M"),
        ReferenceRange(
            "duration_slope", "duration: slope, 500 fps", "2.2-2.7", 2.0, 3.0, "Lee 2002 S* (secondary)", "ms/deg"
        ),
        ReferenceRange(
            "duration_intercept", "duration: intercept, 500 fps", "20-30", 18, 32, "Lee 2002 S* (secondary)", "ms"
        ),
        ReferenceRange("peak_shape", "peak speed x duration / amplitude, 500 fps", "1.65", 1.5, 1.8, "R"),
        ReferenceRange("peak_5", "peak at 25 fps / true peak, A about 5 deg", "0.47", 0.40, 0.55, "M"),
        ReferenceRange("peak_20", "peak at 25 fps / true peak, A about 20 deg", "0.77", 0.70, 0.85, "M"),
    ),
    "Eyes": (
        ReferenceRange("eye_yaw", "eye-in-head within a clip: yaw SD", "4-7", 3, 8, "D", "deg"),
        ReferenceRange("eye_pitch", "eye-in-head within a clip: pitch SD", "3-5", 2, 6, "D", "deg"),
        ReferenceRange(
            "oculomotor_range", "frames with |yaw| < 30, pitch -30 to 20 deg", "all", 100, 100, "D, Stahl 1999", "%"
        ),
        ReferenceRange("conjugacy", "left / right correlation of yaw velocity", "0.99", 0.97, 1, "D"),
        ReferenceRange("torsion", "Listing's law: torsion, RMS", "0", 0, 1, "S", "deg"),
        ReferenceRange("vergence", "vergence at the partner, 1 m", "2.5", 1.5, 4, "M, Malinov 2000", "deg"),
        ReferenceRange("vor_yaw", "VOR: slope of eye on head in fixation, yaw", "-0.95 to -1", -1.05, -0.90, "S"),
        ReferenceRange("vor_pitch", "VOR: slope of eye on head in fixation, pitch", "-0.95 to -1", -1.05, -0.90, "S"),
        ReferenceRange("head_onset_lag", "head onset - eye onset, median", "20-50", 10, 60, "R", "ms"),
        ReferenceRange(
            "head_contribution_10", "head contribution at 10 deg eccentricity", "< 0.3", 0, 0.4, "Stahl 1999 R"
        ),
        ReferenceRange(
            "head_contribution_25", "head contribution at 25 deg eccentricity", "0.3-0.6", 0.2, 0.75, "Stahl 1999 R"
        ),
        ReferenceRange(
            "speed", "mean speed of eye-in-head, 25 fps", "-", 12, 20, "M (the paper's 16.2 is in pixels)", "deg/s"
        ),
        ReferenceRange("psd_gaze", "spectral slope of gaze in space, 0.5-5 Hz", "-2", -2.5, -1.7, "M"),
    ),
    "Partner gaze": (
        ReferenceRange(
            "partner_gaze",
            "partner gaze while talking, mean over speakers",
            "0.41-0.77",
            0.45,
            0.70,
            "Argyle, Lee 2002",
        ),
        ReferenceRange("partner_gaze_sd", "partner gaze while talking, SD over speakers", "-", 0.10, 0.25, "D"),
        ReferenceRange(
            "partner_gaze_listening", "partner gaze while listening", "0.75-0.95", 0.70, 0.95, "Argyle, Lee 2002"
        ),
        ReferenceRange(
            "start_averted",
            "long turns that start with gaze averted",
            "> 0.70",
            0.40,
            0.80,
            "Kendon via Rutter 1978 S*, Wohltjen 2021",
        ),
        ReferenceRange(
            "end_looking",
            "long turns that end with gaze at the partner",
            "> 0.70",
            0.55,
            0.80,
            "Kendon via Rutter 1978 S*",
        ),
        ReferenceRange(
            "aversion_duration", "aversion duration, median", "0.9-3.5", 0.8, 2.5, "Lee 2002, Andrist 2013 R", "s"
        ),
        ReferenceRange(
            "partner_gaze_duration",
            "dwell time at the partner, median",
            "1-5",
            1.0,
            4.5,
            "Lee 2002, Andrist 2013 R, Wohltjen 2021",
            "s",
        ),
        ReferenceRange(
            "aversion_lead",
            "aversion onset - utterance onset, median",
            "-1.3 to -1.0",
            -1.5,
            -0.2,
            "Andrist 2013 R",
            "s",
        ),
        ReferenceRange(
            "aversion_lead_iqr", "aversion onset - utterance onset, IQR", "-", 0.8, INF, "Andrist 2013 R", "s"
        ),
    ),
    "Head": (
        ReferenceRange("head_yaw", "head within a clip: yaw SD", "4.5", 3, 6.5, "U", "deg"),
        ReferenceRange("head_pitch", "head within a clip: pitch SD", "3", 2, 5, "U", "deg"),
        ReferenceRange("head_roll", "head within a clip: roll SD", "2.5", 1.2, 4, "U", "deg"),
        ReferenceRange("head_speed", "mean head speed while speaking", "8-14", 5, 18, "Hadar 1983, U", "deg/s"),
        ReferenceRange(
            "head_ratio", "head speed in speech / in pauses and listening", "> 1.5", 1.3, 3.5, "Hadar 1983, U"
        ),
        ReferenceRange("head_fast", "head velocity power above 1.8 Hz", "some", 3, 20, "Hadar 1983 R", "%"),
        ReferenceRange("psd_head", "spectral slope of the head, 0.5-5 Hz", "-3", -4.2, -2.3, "M, U"),
        ReferenceRange(
            "prosody_cca", "canonical correlation of head and prosody, per sentence", "0.7", 0.45, 0.80, "Busso 2005 R"
        ),
        ReferenceRange(
            "pitch_level_correlation", "|r| of head pitch and level, all frames", "0.1-0.3", 0.05, 0.35, "D"
        ),
    ),
    "Blinks": (
        ReferenceRange(
            "blink_rate",
            "blinks per minute, profile physiological, mean",
            "21-26",
            18,
            30,
            "Doughty 2001, Bentivoglio 1997 S*",
        ),
        ReferenceRange("blink_low", "blink rate, 2.5 % quantile over people", "10", 8, 45, "Doughty 2001 S*", "1/min"),
        ReferenceRange(
            "blink_high", "blink rate, 97.5 % quantile over people", "32", 8, 45, "Doughty 2001 S*", "1/min"
        ),
        ReferenceRange("paper_mean", "profile paper, 1,000 sampled rates: mean", "40.10", 38.6, 41.6, "paper", "1/min"),
        ReferenceRange("paper_sd", "profile paper, 1,000 sampled rates: SD", "15.42", 14.42, 16.42, "paper", "1/min"),
        ReferenceRange(
            "log_normal", "rates of 500 sampled speakers log-normal: p", "yes", 0.05, 1, "Bentivoglio 1997 S*"
        ),
        ReferenceRange("blink_cv", "variation of blink intervals", "0.6-1", 0.5, 1.1, "U", "CV"),
        ReferenceRange("blink_length", "blink duration, 500 fps", "334", 220, 420, "VanderWerf 2003 R", "ms"),
        ReferenceRange("blink_down", "closing time of the lids, 500 fps", "92", 60, 120, "VanderWerf 2003 R", "ms"),
        ReferenceRange("blink_up", "opening time of the lids, 500 fps", "242", 150, 320, "VanderWerf 2003 R", "ms"),
        ReferenceRange(
            "blink_faster", "peak closing / opening speed, 500 fps", "1.4-1.5 or more", 1.3, 3, "Sforza 2008 S*"
        ),
        ReferenceRange(
            "phrase_end", "blink rate within 0.5 s of phrase ends / elsewhere", "> 1", 1.5, 4, "Nakano 2010 S*, D"
        ),
        ReferenceRange(
            "gaze_evoked_blinks",
            "P(blink) at gaze shifts of 20-30 deg less model",
            "0",
            -0.12,
            0.12,
            "Evinger 1994 S*, D",
        ),
    ),
    "Lids and jaw": (
        ReferenceRange("ear_open", "eye aspect ratio, neutral", "0.33", 0.25, 0.38, "M, S"),
        ReferenceRange("ear_shut", "eye aspect ratio, shut", "< 0.12", 0, 0.15, "M, S"),
        ReferenceRange("lid_down", "gain of the upper lid, gaze down", "1", 0.85, 1.05, "Becker & Fuchs 1988 S*"),
        ReferenceRange("lid_up", "gain of the upper lid, gaze up", "< 1", 0.65, 0.95, "Becker & Fuchs 1988 S*"),
        ReferenceRange("lid_model", "Eyelid model, stage one: R2 without blinks", "high", 0.85, 0.97, "D"),
        ReferenceRange("jaw_wide", "jaw opening in speech, 95th percentile", "0.20", 0.12, 0.28, "U", "rad"),
        ReferenceRange("jaw_hz", "jaw velocity: peak frequency", "3-6", 3, 6.5, "U", "Hz"),
        ReferenceRange("jaw_envelope", "correlation of jaw and envelope", "0.5-0.75", 0.45, 0.80, "D"),
    ),
    "Sound and motion": (
        ReferenceRange("eye_r2", "sound to eye angles, unseen speakers: R2", "0", -INF, 0.05, "D"),
        ReferenceRange("averted_auc", "sound to averted state, unseen speakers: AUC", "weak", 0.56, 0.68, "D"),
        ReferenceRange("head_r2", "sound to head pitch, unseen speakers: R2", "low", 0.03, 0.20, "D"),
        ReferenceRange("between_take_eye", "variance between takes / total, same sound: eye", "high", 0.85, 1, "D"),
        ReferenceRange("between_take_head", "variance between takes / total, same sound: head", "high", 0.70, 1, "D"),
        ReferenceRange("between_take_jaw", "variance between takes / total, same sound: jaw", "low", 0, 0.15, "D"),
        ReferenceRange(
            "icc_blink", "style, ICC over half minutes: blink rate", "stable", 0.5, 0.9, "Rogers 2018 S*, D"
        ),
        ReferenceRange(
            "icc_partner_gaze", "style, ICC over half minutes: partner gaze", "stable", 0.5, 0.9, "Rogers 2018 S*, D"
        ),
        ReferenceRange("icc_head", "style, ICC over half minutes: head SD", "stable", 0.5, 0.9, "Rogers 2018 S*, D"),
        ReferenceRange(
            "matching_auc_space", "matched / mismatched sound, gaze in space, 8 s: AUC", "> 0.5", 0.55, 0.75, "D"
        ),
        ReferenceRange(
            "matching_auc_gaze",
            "matched / mismatched sound, gaze and head, 8 s: AUC",
            "> 0.5",
            0.55,
            0.92,
            "Hadar 1983 R, M",
            # A head that moves more in speech than in pauses is sufficient: with a speed ratio of 1.4, near the lower
            # bound of head_ratio, a critic of the head alone reaches 0.85. Gaze has a range of its own.
            previous_range="0.55 to 0.75, D: contradicts the range of head speed in speech / in pauses;"
            " with 1.4 the head alone gives 0.85",
        ),
        ReferenceRange("matching_p_gaze", "matched / mismatched, gaze and head: permutation p", "small", 0, 0.01, "D"),
        ReferenceRange("matching_auc_jaw", "matched / mismatched sound, jaw, 8 s: AUC", "high", 0.95, 1, "D"),
    ),
    "Fitting": (
        ReferenceRange("fit_error", "LightGazeFit: error", "0.73", 0, 0.95, "paper", "px"),
        ReferenceRange("fit_peak", "LightGazeFit: saccade peak speed / truth", "1", 0.8, INF, "D"),
        ReferenceRange("fit_speed", "LightGazeFit: speed / truth", "1.14", 1.0, 1.25, "paper"),
    ),
}
REFERENCE_RANGES: tuple[ReferenceRange, ...] = tuple(each for ranges in RANGES_BY_SECTION.values() for each in ranges)
