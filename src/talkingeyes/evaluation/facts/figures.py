"""Every figure of the acceptance table, by the name of its fact, from pools of clips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.facts import blinks, eyes, face, head, looking, probes, saccades
from talkingeyes.evaluation.facts.clip import Measured, Pool, Seen, benchmark, measured, missing, sums

RATES_FPS = (500, 120, 60, 25)
Figures = dict[str, Measured]


def observe(seen: Seen) -> Pool:
    """All that one clip at its own frame rate tells."""
    behaviour, pool = seen.behaviour, dict(sums(seen.behaviour))
    if behaviour.head is not None and behaviour.gaze is not None:
        pool |= {**saccades.observe(behaviour), **eyes.observe(behaviour, seen.squint_rad)}
    if seen.events is not None:
        pool |= eyes.observe_events(seen.events)
    if behaviour.lid is not None:
        pool |= blinks.observe(seen.speaker, behaviour, seen.annotation)
    if seen.motion is not None:
        pool |= face.observe_lids(_in_mood(seen), seen.motion)
    if seen.annotation is not None:
        pool |= {**looking.observe(seen.speaker, behaviour, seen.annotation), **_style(seen)}
        if seen.sounding is not None:
            pool |= head.observe(behaviour, seen.annotation, seen.sounding)
            if seen.motion is not None:
                pool |= face.observe_jaw(seen.motion, behaviour, seen.annotation, seen.sounding)
    return pool


def _in_mood(seen: Seen) -> str:
    """Whose lids these are: fear widens and sadness narrows one person's eyes, which is not for gaze to explain."""
    said = seen.annotation
    return seen.speaker if said is None else f"{seen.speaker} {said.emotion} {said.intensity}"


def _style(seen: Seen) -> dict[str, np.ndarray]:
    behaviour = seen.behaviour
    assert behaviour.head is not None
    away = np.degrees(behaviour.head[behaviour.valid])
    seconds, fps = len(behaviour) / behaviour.fps, behaviour.fps
    return {
        "style.speaker": np.array([seen.speaker]),
        "style.s": np.array([seconds]),
        "style.blinks": np.array([float(len(behaviour.blinks))]),
        "style.looked_s": np.array([float((~behaviour.states.averted).sum()) / fps]),
        "style.head_deg_s": np.array([float(np.sqrt(away.var(axis=0).sum())) * seconds]),
    }


def of_gaze(pool: Pool) -> Figures:
    """Saccades, eyes and spectrum of gaze."""
    return {
        "below_5": saccades.share_below(pool, 5.0),
        "below_15": saccades.share_below(pool, 15.0),
        "amplitude": saccades.mean_amplitude(pool),
        "cardinal": saccades.cardinal(pool),
        "rate": saccades.rate(pool),
        "eye_yaw": benchmark(pool, "eye/sd_yaw"),
        "eye_pitch": benchmark(pool, "eye/sd_pitch"),
        "in_range": eyes.in_range(pool),
        "conjugacy": benchmark(pool, "eye/conjugacy"),
        "torsion": benchmark(pool, "eye/torsion"),
        "vergence": eyes.vergence(pool),
        "vor_yaw": _slope(pool, "yaw"),
        "vor_pitch": _slope(pool, "pitch"),
        "speed": benchmark(pool, "eye/speed"),
        "psd_gaze": benchmark(pool, "space/spectrum_slope"),
    }


def _slope(pool: Pool, axis: str) -> Measured:
    """Of eye velocity on head velocity between saccades."""
    product, square = (float(pool[f"counter.{axis}{end}"].sum()) for end in ("", "_head"))
    return measured(product / square if square else np.nan, int(pool["counter.frames"].sum()), "frames", 1500)


def of_rates(pool: Pool) -> Figures:
    """The main sequence at the highest rate, and what is left of its peaks at 25 frames a second."""
    law = saccades.law(pool, "at500")
    return {
        "largest": saccades.largest(pool, "at500"),
        "vmax": law["most"],
        "constant": law["constant"],
        "slope_10": saccades.log_slope(pool, "at500", 0.5, 10.0),
        "slope_40": saccades.log_slope(pool, "at500", 0.5, 40.0),
        "duration_slope": law["slope"],
        "duration_intercept": law["intercept"],
        "shape": law["shape"],
        "peak_5": saccades.peak_ratio(pool, "same25", 4.0, 6.0),
        "peak_20": saccades.peak_ratio(pool, "same25", 16.0, 24.0),
    }


def of_shifts(pool: Pool) -> Figures:
    """Large gaze shifts, which are rare: the head's share of them, and blinks with them."""
    return {
        "share_10": eyes.head_share(pool, 8.0, 12.0),
        "share_25": eyes.head_share(pool, 21.0, 30.0),
        "evoked": blinks.evoked(pool),
    }


def observe_shifts(behaviour: Behaviour) -> Pool:
    """What `of_shifts` needs of one motion."""
    return {**eyes.observe_shifts(behaviour), **blinks.observe_shifts(behaviour)}


def of_head(pool: Pool) -> Figures:
    """Spread, speed and spectrum of the head."""
    return {
        "head_yaw": benchmark(pool, "head/sd_yaw"),
        "head_pitch": benchmark(pool, "head/sd_pitch"),
        "head_roll": benchmark(pool, "head/sd_roll"),
        "head_fast": head.fast_share(pool),
        "psd_head": benchmark(pool, "head/spectrum_slope"),
    }


def of_speech(pool: Pool) -> Figures:
    """What needs the sound's annotation: looking, the head in speech, blinks at phrase ends, jaw, styles."""
    talking, onset = looking.share(pool, "talking"), looking.before_onset(pool)
    return {
        "look": talking["mean"],
        "look_sd": talking["sd"],
        "look_listening": looking.listening_share(pool),
        "start_averted": looking.at_utterances(pool, "start"),
        "end_looking": _complement(looking.at_utterances(pool, "end")),
        "aversion": looking.dwell_median(pool, True),
        "mutual": looking.dwell_median(pool, False),
        "onset": onset["median"],
        "onset_iqr": onset["iqr"],
        "head_speed": head.speaking_speed(pool),
        "head_ratio": benchmark(pool, "head/speaking_ratio"),
        "phrase_end": blinks.phrase_odds(pool),
        "icc_blink": probes.style_agreement(pool, "blinks"),
        "icc_look": probes.style_agreement(pool, "looked_s"),
        "icc_head": probes.style_agreement(pool, "head_deg_s"),
    }


def _complement(share: Measured) -> Measured:
    return share if share.value is None else Measured(1 - share.value, share.count, share.counted)


def of_prosody(pool: Pool) -> Figures:
    """What needs the sound itself."""
    return {
        "cca": head.sentence_correlation(pool),
        "tie": head.frame_correlation(pool),
        "jaw_wide": face.jaw_wide(pool),
        "jaw_hz": face.jaw_peak_hz(pool),
        "jaw_envelope": face.jaw_envelope(pool),
    }


def of_blinks(pool: Pool) -> Figures:
    """Rates over people, intervals, blinks at gaze shifts."""
    rate = blinks.rate(pool)
    return {
        "blink_rate": rate["mean"],
        "blink_low": rate["low"],
        "blink_high": rate["high"],
        "blink_cv": benchmark(pool, "blinks/interval_cv"),
    }


def of_courses(pool: Pool) -> Figures:
    """Kinematics of blinks at the highest rate."""
    course = blinks.course(pool)
    return {f"blink_{name}": course[name] for name in ("length", "down", "up", "faster")}


def of_lids(pool: Pool) -> Figures:
    """Lids that follow gaze."""
    gains = face.lid_gains(pool)
    return {"lid_down": gains["down"], "lid_up": gains["up"], "lid_model": face.lid_explained(pool)}


def of_takes(pool: Pool) -> Figures:
    """Shares of variance that a new draw makes."""
    return {f"seed_{part}": probes.seed_share(pool, part) for part in ("eye", "head", "jaw")}


def of_draws(paper: Sequence[float], physio: Sequence[float]) -> Figures:
    """Drawn blink rates: 1,000 of the profile `paper`, 500 speakers of the profile `physio`."""
    return {
        "paper_mean": measured(float(np.mean(paper)), len(paper), "draws"),
        "paper_sd": measured(float(np.std(paper, ddof=1)), len(paper), "draws"),
        "log_normal": blinks.log_normal(physio),
    }


def of_fit(table8: Mapping[str, Any]) -> Figures:
    """Table VIII, as the stage `fit` has it."""
    rows = {row["method"]: row for row in table8["rows"]}

    def cell(method: str, key: str) -> Measured:
        if key not in rows.get(method, {}):
            return missing(f"fit has no {key} of {method}")
        return measured(rows[method][key], rows[method]["clips"], "clips")

    return {
        "fit_error": cell("lightgazefit", "error_px"),
        "fit_peak": cell("lightgazefit", "saccade_peak_ratio"),
        "fit_speed": cell("lightgazefit", "velocity_ratio"),
    }


def onset_lag(pool: Pool) -> Measured:
    """How much later than the eyes the head starts."""
    return eyes.onset_lag_ms(pool)


def of_heads() -> Figures:
    """The eye aspect ratio of the open head."""
    return {
        "ear_open": measured(face.aspect_ratio(0.0), 1, "head"),
        "ear_shut": measured(face.aspect_ratio(1.0), 1, "head"),
    }


def of_pupils(pool: Pool, projected_px: float) -> Figures:
    """A fitter like Gaze360, simulated, and the projection of the pupils."""
    distance, distances, speed, true = pool["raw.sums"].sum(axis=0)
    count = len(pool["raw.sums"])
    return {
        "raw_error": measured(distance / max(distances, 1), count, "clips"),
        "raw_speed": measured(speed / max(true, 1e-9), count, "clips"),
        "projected": measured(projected_px, 2, "pupils"),
    }
