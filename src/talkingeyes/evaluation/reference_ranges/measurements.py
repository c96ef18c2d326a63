"""All values of the table of reference ranges, by the name of the range, from pools of clips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from talkingeyes.evaluation.benchmark.table import METRICS_BY_NAME
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures import blinks, eye_head, lids_and_jaw, movement, partner_gaze, saccades
from talkingeyes.evaluation.measures.pooled import (
    ClipData,
    Measurement,
    PooledArrays,
    measurement,
    no_measurement,
)
from talkingeyes.evaluation.reference_ranges import probes

RATES_FPS = (500, 120, 60, 25)
Measurements = dict[str, Measurement]
# Sums of the gaze benchmark that values are computed from.
EXTRACTORS = (
    saccades.OBSERVER,
    partner_gaze.STATES,
    partner_gaze.CURVES,
    eye_head.BINOCULAR,
    eye_head.EYE_HEAD,
    movement.EYE,
    movement.SPACE,
    movement.HEAD,
    movement.SPEAKING,
    blinks.BLINKS,
)


def benchmark_sums(behaviour: Behaviour) -> dict[str, ndarray]:
    """Benchmark sums of one clip, each with a first axis of length 1."""
    found: dict[str, ndarray] = {}
    for extractor in EXTRACTORS:
        if all(behaviour.has(field) for field in extractor.needs):
            found |= {name: np.asarray(value, float)[None] for name, value in extractor.extract(behaviour).items()}
    return found


def benchmark_metric(pool: PooledArrays, name: str) -> Measurement:
    """A metric of the gaze benchmark, computed from the sums in the pool."""
    metric = METRICS_BY_NAME[name]
    assert metric.compute is not None
    if metric.count_key not in pool:
        return no_measurement(f"no {' and '.join(metric.extractor.needs)}")
    totals = {key: pool[key].sum(axis=0, keepdims=True) for key in metric.extractor.sizes}
    with np.errstate(invalid="ignore", divide="ignore"):
        value = float(metric.compute(totals)[0])
    return measurement(value, int(totals[metric.count_key][0]), metric.count_unit, metric.min_count)


def extract(clip_data: ClipData) -> PooledArrays:
    """Pool of one clip at its own frame rate."""
    behaviour, pool = clip_data.behaviour, dict(benchmark_sums(clip_data.behaviour))
    if behaviour.head is not None and behaviour.gaze is not None:
        pool |= {**saccades.extract_pool(behaviour), **eye_head.extract_pool(behaviour, clip_data.axis_divergence_rad)}
    if clip_data.events is not None:
        pool |= eye_head.extract_events(clip_data.events)
    if behaviour.lid is not None:
        pool |= blinks.extract_pool(clip_data.speaker, behaviour, clip_data.annotation)
    if clip_data.motion is not None:
        pool |= lids_and_jaw.extract_lids(_in_mood(clip_data), clip_data.motion)
    if clip_data.annotation is not None:
        pool |= {**partner_gaze.extract_pool(clip_data.speaker, behaviour, clip_data.annotation), **_style(clip_data)}
        if clip_data.frame_prosody is not None:
            pool |= movement.extract_pool(behaviour, clip_data.annotation, clip_data.frame_prosody)
            if clip_data.motion is not None:
                pool |= lids_and_jaw.extract_jaw(
                    clip_data.motion, behaviour, clip_data.annotation, clip_data.frame_prosody
                )
    return pool


def _in_mood(clip_data: ClipData) -> str:
    """Group for the fit of lids: speaker and emotion, since emotions widen or narrow the eyes regardless of gaze."""
    said = clip_data.annotation
    return clip_data.speaker if said is None else f"{clip_data.speaker} {said.emotion} {said.intensity}"


def _style(clip_data: ClipData) -> dict[str, np.ndarray]:
    behaviour = clip_data.behaviour
    assert behaviour.head is not None
    away = np.degrees(behaviour.head[behaviour.valid])
    seconds, fps = len(behaviour) / behaviour.fps, behaviour.fps
    return {
        "style.speaker": np.array([clip_data.speaker]),
        "style.s": np.array([seconds]),
        "style.blinks": np.array([float(len(behaviour.blinks))]),
        "style.looked_s": np.array([float((~behaviour.states.averted).sum()) / fps]),
        "style.head_deg_s": np.array([float(np.sqrt(away.var(axis=0).sum())) * seconds]),
    }


def measure_gaze(pool: PooledArrays) -> Measurements:
    """Statistics of saccades, of the eyes and of the spectrum of gaze."""
    return {
        "below_5": saccades.fraction_below(pool, 5.0),
        "below_15": saccades.fraction_below(pool, 15.0),
        "amplitude": saccades.mean_amplitude(pool),
        "cardinal": saccades.cardinal_ratio(pool),
        "rate": saccades.saccade_rate(pool),
        "eye_yaw": benchmark_metric(pool, "eye/sd_yaw"),
        "eye_pitch": benchmark_metric(pool, "eye/sd_pitch"),
        "oculomotor_range": eye_head.within_motor_range(pool),
        "conjugacy": benchmark_metric(pool, "eye/conjugacy"),
        "torsion": benchmark_metric(pool, "eye/torsion"),
        "vergence": eye_head.vergence_deg(pool),
        "vor_yaw": benchmark_metric(pool, "head_eye/slope_yaw"),
        "vor_pitch": benchmark_metric(pool, "head_eye/slope_pitch"),
        "speed": benchmark_metric(pool, "eye/speed"),
        "psd_gaze": benchmark_metric(pool, "gaze_in_space/spectrum_slope"),
    }


def measure_main_sequence(pool: PooledArrays) -> Measurements:
    """Main sequence at the highest frame rate, and ratio of peak speeds at 25 frames per second to the true ones."""
    return {
        "largest": saccades.largest_amplitude(pool, "at500"),
        **saccades.main_sequence_model(pool, "at500"),
        "slope_10": saccades.log_slope(pool, "at500", 0.5, 10.0),
        "slope_40": saccades.log_slope(pool, "at500", 0.5, 40.0),
        "peak_5": saccades.peak_ratio(pool, "same25", 4.0, 6.0),
        "peak_20": saccades.peak_ratio(pool, "same25", 16.0, 24.0),
    }


def measure_gaze_shifts(pool: PooledArrays) -> Measurements:
    """Head contribution to large gaze shifts, which are rare, and blinks that accompany them."""
    return {
        "head_contribution_10": eye_head.head_contribution(pool, 8.0, 12.0),
        "head_contribution_25": eye_head.head_contribution(pool, 21.0, 30.0),
        "gaze_evoked_blinks": blinks.gaze_evoked(pool),
    }


def extract_gaze_shifts(behaviour: Behaviour) -> PooledArrays:
    """Pool of one motion for `measure_gaze_shifts`."""
    return {**eye_head.extract_gaze_shifts(behaviour), **blinks.extract_gaze_shifts(behaviour)}


def measure_head(pool: PooledArrays) -> Measurements:
    """Spread and spectrum of the head."""
    return {
        "head_yaw": benchmark_metric(pool, "head/sd_yaw"),
        "head_pitch": benchmark_metric(pool, "head/sd_pitch"),
        "head_roll": benchmark_metric(pool, "head/sd_roll"),
        "head_fast": movement.fast_power_fraction(pool),
        "psd_head": benchmark_metric(pool, "head/spectrum_slope"),
    }


def measure_speech(pool: PooledArrays) -> Measurements:
    """Statistics that need the annotation: partner gaze, the head in speech, blinks at phrase ends, styles."""
    return {
        **partner_gaze.partner_gaze_fraction(pool),
        "partner_gaze_listening": partner_gaze.listening_fraction(pool),
        "start_averted": partner_gaze.averted_at_utterances(pool, "start"),
        "end_looking": _complement(partner_gaze.averted_at_utterances(pool, "end")),
        "aversion_duration": partner_gaze.dwell_median(pool, True),
        "partner_gaze_duration": partner_gaze.dwell_median(pool, False),
        **partner_gaze.aversion_lead(pool),
        "head_speed": movement.speaking_speed(pool),
        "head_ratio": benchmark_metric(pool, "head/speech_speed_ratio"),
        "phrase_end": blinks.phrase_end_ratio(pool),
        "icc_blink": probes.style_icc(pool, "blinks"),
        "icc_partner_gaze": probes.style_icc(pool, "looked_s"),
        "icc_head": probes.style_icc(pool, "head_deg_s"),
    }


def _complement(fraction: Measurement) -> Measurement:
    return fraction if fraction.value is None else Measurement(1 - fraction.value, fraction.count, fraction.count_unit)


def measure_prosody(pool: PooledArrays) -> Measurements:
    """Statistics that need the sound: correlation of head and jaw with prosody, jaw opening."""
    return {
        "prosody_cca": movement.sentence_correlation(pool),
        "pitch_level_correlation": movement.frame_correlation(pool),
        "jaw_wide": lids_and_jaw.jaw_opening_p95(pool),
        "jaw_hz": lids_and_jaw.jaw_peak_hz(pool),
        "jaw_envelope": lids_and_jaw.jaw_envelope(pool),
    }


def measure_blinks(pool: PooledArrays) -> Measurements:
    """Blink rates over people and variation of blink intervals."""
    return {**blinks.mean_rate(pool), "blink_cv": benchmark_metric(pool, "blinks/interval_cv")}


def measure_lids(pool: PooledArrays) -> Measurements:
    """Gains of the upper lids and fit of the Eyelid model."""
    return {**lids_and_jaw.lid_gains(pool), "lid_model": lids_and_jaw.lid_r_squared(pool)}


def measure_take_variance(pool: PooledArrays) -> Measurements:
    """Fraction of the variance of eyes, head and jaw that lies between takes."""
    return {f"between_take_{part}": probes.between_take_fraction(pool, part) for part in ("eye", "head", "jaw")}


def measure_blink_rate_draws(paper: Sequence[float], physiological: Sequence[float]) -> Measurements:
    """Sampled blink rates: 1,000 of the profile `paper`, 500 speakers of the profile `physiological`."""
    return {
        "paper_mean": measurement(float(np.mean(paper)), len(paper), "draws"),
        "paper_sd": measurement(float(np.std(paper, ddof=1)), len(paper), "draws"),
        "log_normal": blinks.log_normal_p(physiological),
    }


def measure_fit(table8: Mapping[str, Any]) -> Measurements:
    """Values of Table VIII from the stage `fit`."""
    rows = {row["method"]: row for row in table8["rows"]}

    def cell(method: str, key: str) -> Measurement:
        if key not in rows.get(method, {}):
            return no_measurement(f"stage fit has no {key} of {method}")
        return measurement(rows[method][key], rows[method]["clips"], "clips")

    return {
        "fit_error": cell("lightgazefit", "error_px"),
        "fit_peak": cell("lightgazefit", "saccade_peak_ratio"),
        "fit_speed": cell("lightgazefit", "velocity_ratio"),
    }


def measure_eye_aspect_ratio() -> Measurements:
    """Eye aspect ratio of the open head, lids open and shut."""
    return {
        "ear_open": measurement(lids_and_jaw.eye_aspect_ratio(0.0), 1, "head"),
        "ear_shut": measurement(lids_and_jaw.eye_aspect_ratio(1.0), 1, "head"),
    }
