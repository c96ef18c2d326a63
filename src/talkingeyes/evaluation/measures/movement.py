"""Movement between frames: speed, still frames, spread and spectra of head, eyes and gaze in space.

True gaze in space is still in about nine of ten frames. Jitter lowers this fraction and adds power above 5 Hz;
smoothing removes the fastest frames. Spectra: `detectors/signal.py`.

The reference ranges have the head in speech besides, with two different correlations with prosody. The first canonical
correlation is fitted to each sentence (Busso et al. 2005: about 0.7, optimistic by construction). The plain correlation
over all frames is small.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.kinematics import STILL_THRESHOLD_DEG_S
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.detectors.signal import HIGH_HZ, SEGMENT_S, SLOPE_BAND_HZ, spectrum
from talkingeyes.evaluation.measures.metric import Bins, Extractor, Metric, Sums, Totals, ratio, safe_divide
from talkingeyes.evaluation.measures.pooled import (
    FrameProsody,
    Measurement,
    PooledArrays,
    in_spans,
    measure_values,
    measurement,
    utterances,
)

# log2 of speed in degrees per second: 1/16 to 1024.
LOG2_SPEED_BINS = Bins(-4.0, 10.0, 140)
# Frequencies of the stored spectra; those above the Nyquist frequency stay zero.
FREQUENCY_HZ = np.arange(33) / SEGMENT_S
HEAD_AXES = ("pitch", "yaw", "roll")  # of the rotation vector
PARTS = {"eye": "eye-in-head", "gaze_in_space": "gaze in space", "head": "head"}


def _movement(part: str, speed_deg_s: Float[ndarray, " F"], angles_rad: Float[ndarray, "T C"], of: Behaviour) -> Sums:
    speed = speed_deg_s[of.valid_steps]
    power = spectrum(angles_rad, of.fps, of.valid)
    summed = np.zeros(len(FREQUENCY_HZ))
    summed[: len(power.power)] = power.power.sum(axis=1)[: len(summed)]
    return {
        f"{part}.frames": len(speed),
        f"{part}.speed_deg_s": speed.sum(),
        f"{part}.still": (speed < STILL_THRESHOLD_DEG_S).sum(),
        f"{part}.segments": power.segments,
        f"{part}.speed": LOG2_SPEED_BINS(np.log2(np.maximum(speed, 1e-6))),
        f"{part}.power": summed,
    }


def extract_eye(behaviour: Behaviour) -> Sums:
    """Speeds and spectrum of eye-in-head, mean of both eyes."""
    return _movement("eye", behaviour.eye_speed_deg_s, behaviour.eye_rad.mean(axis=1), behaviour)


def extract_gaze_in_space(behaviour: Behaviour) -> Sums:
    """Speeds and spectrum of gaze in space."""
    return _movement("gaze_in_space", behaviour.gaze_in_space_speed_deg_s, behaviour.gaze_in_space_rad, behaviour)


def extract_head(behaviour: Behaviour) -> Sums:
    """Speeds and spectrum of the head, its spread about the mean of the clip, and moments of its pitch velocity."""
    assert behaviour.head is not None
    good = np.degrees(behaviour.head[behaviour.valid])
    away = np.square(good - good.mean(axis=0)).sum(axis=0)
    pitch_deg_s = -np.degrees(np.diff(behaviour.head[:, 0])[behaviour.valid_steps]) * behaviour.fps
    return {
        **_movement("head", behaviour.head_speed_deg_s, behaviour.head, behaviour),
        **{f"head.{axis}_2": each for axis, each in zip(HEAD_AXES, away, strict=True)},
        "head.valid": len(good),
        "head.down_3": (pitch_deg_s**3).sum(),
        "head.down_2": (pitch_deg_s**2).sum(),
    }


def extract_speaking(behaviour: Behaviour) -> Sums:
    """Frames and summed head speed in speech and in pauses."""
    assert behaviour.annotation is not None
    frames = np.zeros(len(behaviour) - 1, bool)
    for span in behaviour.annotation.speaking:
        frames[max(0, round(span.start_s * behaviour.fps)) : max(0, round(span.end_s * behaviour.fps))] = True
    found: dict[str, Any] = {}
    for name, where in (("speech", frames & behaviour.valid_steps), ("pause", ~frames & behaviour.valid_steps)):
        found |= {f"{name}.frames": where.sum(), f"{name}.speed_deg_s": behaviour.head_speed_deg_s[where].sum()}
    return found


EYE = Extractor(extract_eye, ("gaze",))
SPACE = Extractor(extract_gaze_in_space, ("head", "gaze"))
HEAD = Extractor(extract_head, ("head",))
SPEAKING = Extractor(extract_speaking, ("head", "annotation"))


def _quantile(totals: Totals, part: str) -> Float[ndarray, " D"]:
    return np.asarray(2 ** LOG2_SPEED_BINS.quantile(totals[f"{part}.speed"], 0.99))


def _slope(totals: Totals, part: str) -> Float[ndarray, " D"]:
    """Slope of log power on log frequency; NaN where nothing moves."""
    low, high = SLOPE_BAND_HZ
    band = (low <= FREQUENCY_HZ) & (high >= FREQUENCY_HZ)
    power = totals[f"{part}.power"][:, band]
    x = np.log(FREQUENCY_HZ[band])
    x -= x.mean()
    return np.asarray(np.log(np.where(power > 0, power, np.nan)) @ x / (x @ x))


def _high(totals: Totals, part: str) -> Float[ndarray, " D"]:
    """Fraction of the power of velocity above 5 Hz."""
    velocity = totals[f"{part}.power"] * np.square(FREQUENCY_HZ)
    return safe_divide(velocity[:, FREQUENCY_HZ >= HIGH_HZ].sum(axis=1), velocity.sum(axis=1))


def _decibels(totals: Totals, other: Totals, part: str) -> Float[ndarray, " D"]:
    """Root mean square over frequencies of the ratio in dB of two mean spectra.

    Both are floored at 1e-6 of the maximum of the reference.
    """
    one, two = (
        safe_divide(each[f"{part}.power"], each[f"{part}.segments"][:, None] * np.ones(len(FREQUENCY_HZ)))[:, 1:]
        for each in (totals, other)
    )
    floor = 1e-6 * two.max(axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.square(10 * np.log10(np.maximum(one, floor) / np.maximum(two, floor))).mean(axis=1)))


def _spread(totals: Totals, axis: str) -> Float[ndarray, " D"]:
    return np.asarray(np.sqrt(safe_divide(totals[f"head.{axis}_2"], totals["head.valid"])))


def _nod_skew(totals: Totals) -> Float[ndarray, " D"]:
    count = totals["head.frames"]
    return safe_divide(safe_divide(totals["head.down_3"], count), safe_divide(totals["head.down_2"], count) ** 1.5)


def _speech_ratio(totals: Totals) -> Float[ndarray, " D"]:
    speech, pause = (
        safe_divide(totals[f"{name}.speed_deg_s"], totals[f"{name}.frames"]) for name in ("speech", "pause")
    )
    return safe_divide(speech, np.nan_to_num(pause))


def _speed_metrics(part: str, extractor: Extractor) -> tuple[Metric, ...]:
    title = PARTS[part]
    metric = partial(Metric, extractor=extractor, count_key=f"{part}.frames", min_count=1500, rate_dependent=True)
    return (
        metric(
            f"{part}/speed",
            f"mean speed, {title}",
            "deg/s",
            "mean angle between frames x frames per second",
            compute=ratio(f"{part}.speed_deg_s", f"{part}.frames"),
            source="TalkingEyes, Table VIII (there in pixels)",
            caveat="jitter raises it as real movement does: read it together with still_fraction",
        ),
        metric(
            f"{part}/speed_p99",
            f"99th percentile of speed, {title}",
            "deg/s",
            "99th percentile of speed (bins of a tenth of an octave)",
            compute=partial(_quantile, part=part),
            source="sampling: Mack et al. 2017",
            caveat="limited by the frame rate: frames show a part of a saccade's peak speed",
        ),
        metric(
            f"{part}/speed_distance",
            f"speeds, Wasserstein, {title}",
            "SD of truth",
            "area between the distribution functions of log2 speed / SD of the reference's",
            compare=lambda totals, other: LOG2_SPEED_BINS.distance(totals[f"{part}.speed"], other[f"{part}.speed"]),
            direction="lower",
            source="Kantorovich 1942",
            caveat="slow frames weigh as much as fast ones, so invisible noise counts",
        ),
    )


def _spectrum_metrics(part: str, extractor: Extractor) -> tuple[Metric, ...]:
    title = PARTS[part]
    metric = partial(
        Metric,
        extractor=extractor,
        count_key=f"{part}.segments",
        min_count=40,
        rate_dependent=True,
        source="Welch 1967",
    )
    return (
        metric(
            f"{part}/spectrum_slope",
            f"slope of the spectrum, {title}",
            "log/log",
            "slope of log power on log frequency, 0.5 to 5 Hz; Welch's method, 2.56 s, linearly detrended",
            compute=partial(_slope, part=part),
            caveat="-2 for steps; smooth noise can have any slope",
        ),
        metric(
            f"{part}/above_5_hz",
            f"power above 5 Hz, {title}",
            "fraction",
            "fraction of the power of velocity above 5 Hz",
            compute=partial(_high, part=part),
            caveat="includes aliased power of saccades: compare at one frame rate",
        ),
        metric(
            f"{part}/spectrum_distance",
            f"spectral distance, {title}",
            "dB",
            "root mean square over 0.39 to 12.5 Hz of the ratio in dB to the mean spectrum of the reference",
            compare=partial(_decibels, part=part),
            direction="lower",
            caveat="scaling by a factor alone adds 20 log10 of it at every frequency",
        ),
    )


_head = partial(Metric, extractor=HEAD, count_key="head.valid", min_count=1500, source="Hadar et al. 1983")

METRICS = (
    Metric(
        "gaze_in_space/still_fraction",
        "still frames, gaze in space",
        "fraction",
        f"fraction of steps between frames slower than {STILL_THRESHOLD_DEG_S:g} deg/s",
        compute=ratio("gaze_in_space.still", "gaze_in_space.frames"),
        extractor=SPACE,
        count_key="gaze_in_space.frames",
        min_count=1500,
        rate_dependent=True,
        source="vestibulo-ocular reflex",
        caveat="1 for a frozen face, 0 with jitter of 0.1 deg",
    ),
    *_speed_metrics("gaze_in_space", SPACE),
    *_spectrum_metrics("gaze_in_space", SPACE),
    Metric(
        "eye/still_fraction",
        "still frames, eye-in-head",
        "fraction",
        f"fraction of steps between frames slower than {STILL_THRESHOLD_DEG_S:g} deg/s",
        compute=ratio("eye.still", "eye.frames"),
        extractor=EYE,
        count_key="eye.frames",
        min_count=1500,
        rate_dependent=True,
        source="vestibulo-ocular reflex",
        caveat="the eyes counter-rotate when the head moves: closer to 1 is not better",
    ),
    *_speed_metrics("eye", EYE),
    *_spectrum_metrics("eye", EYE),
    *_speed_metrics("head", HEAD),
    *_spectrum_metrics("head", HEAD),
    *(
        _head(
            f"head/sd_{axis}",
            f"within-clip SD of head {axis}",
            "deg",
            f"root mean square of the {axis} component of the head's rotation vector about the mean of the clip",
            compute=partial(_spread, axis=axis),
            caveat="increases with the length of the clips",
        )
        for axis in HEAD_AXES
    ),
    _head(
        "head/pitch_velocity_skew",
        "skewness of head pitch velocity",
        "",
        "mean (upward velocity)^3 / (mean square)^(3/2)",
        compute=_nod_skew,
        caveat="small and determined by the few fastest nods: about an hour of motion is needed for a reliable sign",
        rate_dependent=True,
    ),
    Metric(
        "head/speech_speed_ratio",
        "head speed in speech / in pauses",
        "ratio",
        "mean head speed inside speaking spans / mean head speed outside",
        compute=_speech_ratio,
        extractor=SPEAKING,
        count_key="pause.frames",
        min_count=500,
        source="Hadar et al. 1983",
        caveat="pauses within a turn are short, and the head does not come to rest in them",
    ),
)


# Statistics of the reference ranges, from arrays pooled over clips (pooled.py).
SLOW_MOVEMENT_HZ = 1.8
MIN_SENTENCE_S = 1.5
RIDGE = 1e-6


def extract_pool(behaviour: Behaviour, annotation: Annotation, frame_prosody: FrameProsody) -> PooledArrays:
    """Canonical correlations of the utterances, and products of head pitch and level in speech."""
    assert behaviour.head is not None
    frames = min(len(behaviour), len(frame_prosody.energy_dbfs))
    prosody = prosodic_features(frame_prosody)[:frames]
    found = []
    for span in utterances(annotation):
        low, high = round(span.start_s * behaviour.fps), min(round(span.end_s * behaviour.fps), frames)
        if high - low >= MIN_SENTENCE_S * behaviour.fps and behaviour.valid[low:high].all():
            found.append(canonical_correlation(behaviour.head[low:high], prosody[low:high]))
    speech = in_spans(annotation.speaking, behaviour)[:frames] & behaviour.valid[:frames]
    level, pitch = frame_prosody.energy_dbfs[:frames][speech], behaviour.head_rad[:frames, 1][speech]
    products = np.zeros(4)
    if len(level):
        level, pitch = level - level.mean(), np.degrees(pitch - pitch.mean())
        products = np.array([level @ pitch, level @ level, pitch @ pitch, len(level)])
    return {"cca.r": np.array(found), "tie.products": products[None]}


def prosodic_features(frame_prosody: FrameProsody) -> Float[ndarray, "T 6"]:
    """Level and log F0 (interpolated where unvoiced), with their first and second differences."""
    known = np.isfinite(frame_prosody.f0_hz)
    frames = np.arange(len(known))
    log_f0 = (
        np.interp(frames, frames[known], np.log(frame_prosody.f0_hz[known])) if known.any() else np.zeros(len(known))
    )
    base = np.stack([frame_prosody.energy_dbfs, log_f0], axis=1)
    first = np.gradient(base, axis=0)
    return np.concatenate([base, first, np.gradient(first, axis=0)], axis=1)


def canonical_correlation(one: Float[ndarray, "T A"], other: Float[ndarray, "T B"]) -> float:
    """First canonical correlation; NaN if either input is constant."""
    bases = []
    for each in (one, other):
        left, size, _ = np.linalg.svd(each - each.mean(axis=0), full_matrices=False)
        bases.append(left[:, size > RIDGE * max(float(size[0]), 1e-12)])
    if not (bases[0].shape[1] and bases[1].shape[1]):
        return float("nan")
    return float(min(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[0], 1.0))


def sentence_correlation(pool: PooledArrays) -> Measurement:
    """Mean over sentences of the first canonical correlation."""
    found = pool["cca.r"]
    found = found[np.isfinite(found)]
    return measure_values(found, np.mean, "sentences", 20)


def frame_correlation(pool: PooledArrays) -> Measurement:
    """Absolute correlation of head pitch and level over all speaking frames, both about the mean of the clip."""
    across, level, pitch, frames = pool["tie.products"].sum(axis=0)
    return measurement(abs(across) / max(np.sqrt(level * pitch), 1e-12), int(frames), "frames", 1500)


def fast_power_fraction(pool: PooledArrays) -> Measurement:
    """Percentage of the power of head velocity above 1.8 Hz."""
    if "head.power" not in pool:
        return measurement(np.nan, 0, "segments", 1)
    velocity = pool["head.power"].sum(axis=0) * np.square(FREQUENCY_HZ)
    total, segments = float(velocity.sum()), int(pool["head.segments"].sum())
    share = 100 * float(velocity[FREQUENCY_HZ > SLOW_MOVEMENT_HZ].sum()) / max(total, 1e-12)
    return measurement(share, segments, "segments", 40)


def speaking_speed(pool: PooledArrays) -> Measurement:
    """Mean head speed in speech, degrees per second."""
    frames = float(pool["speech.frames"].sum()) if "speech.frames" in pool else 0.0
    return measurement(
        float(pool["speech.speed_deg_s"].sum()) / frames if frames else np.nan, int(frames), "frames", 1500
    )
