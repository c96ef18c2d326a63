"""The frame rate of a table and the frame of each of its rows, from the times that programs write.

    0.033                        seconds, usually rounded (also in ms, us or ns)
    18:48:59.100                 hours, minutes, seconds; also after a date
    18:48:59:02, :02.500, ;02    time codes: the last number counts frames; after `;` it leaves out some (drop-frame)
    00:00:00:02.002              Face_Landmark_Link: the thousandths count frames from the start of the video

Rows that are missing leave frames without a row. Where times repeat or are uneven, rows keep their order, one a frame.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray

from talkingeyes.core.errors import InputError

SECONDS = re.compile(r"\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?")
CLOCK = re.compile(r"(?:\d+([-./])\d+\1\d+,?[T ])?(?:(\d+):)?(\d+):(\d+(?:[.,]\d{3,})?)(?:Z|[+-]\d\d:?\d\d)?")
TIMECODE = re.compile(r"(\d+):(\d+):(\d+)([:;.,])(\d+(?:[.,]\d+)?)")
CODE_RATES = (24, 25, 30, 48, 50, 60, 72, 90, 100, 120, 240)  # frames that time codes count in a second
NTSC = 1000 / 1001
NTSC_RATES = tuple(rate * NTSC for rate in (24, 30, 60, 120))
USUAL_RATES = (*map(float, CODE_RATES), *NTSC_RATES, 10.0, 12.0, 12.5, 15.0, 20.0, 15 * NTSC, 200.0)
RATE_TOLERANCE = 2e-4
TIMING_TOLERANCE_S = 0.003  # maximum deviation from even time steps
EARLY = 0.25  # of a frame, by which a row after a missing one may come too early
UNEVEN = 2.5  # frames between two rows of uneven times, from which on rows are missing
MIN_FPS, MAX_FPS = 5.0, 400.0
UNITS = (1.0, 1e3, 1e6, 1e9)  # of times without colons, in a second


@dataclass(frozen=True)
class Timing:
    """Frame rate of a table, and the frame of each of its rows, from 0."""

    fps: float
    frames: Int[ndarray, " T"]

    @property
    def count(self) -> int:
        """Number of frames."""
        return int(self.frames[-1]) + 1

    def on_frames(self, rows: Shaped[ndarray, "T ..."]) -> Shaped[ndarray, "F ..."]:
        """Values of the rows by frame; 0 (or False) where a frame has no row."""
        values = np.zeros((self.count, *rows.shape[1:]), rows.dtype)
        values[self.frames] = rows
        return values


def row_timing(codes: Sequence[str], rows: int, fps: float | None) -> Timing:
    """The timing of rows with these times (none where a table has none). With `fps`, rows are frames."""
    if rows < 2:
        raise InputError("should hold two or more frames with time codes like 18:48:59:39.473")
    if fps is not None:
        return Timing(fps, np.arange(rows))
    if not codes:
        raise InputError("should contain time codes, got none; set --fps")
    for form, reader in ((SECONDS, _seconds), (CLOCK, _clock), (TIMECODE, _time_codes)):
        found = [form.fullmatch(code.strip()) for code in codes]
        if all(found):
            return reader([match for match in found if match])
    odd = next(code for code, match in zip(codes, found, strict=True) if not match)
    raise InputError(f"should hold time codes like 18:48:59:39.473 or seconds, got {odd!r}; set --fps")


def timing_of_times(times_s: Float[ndarray, " T"]) -> Timing:
    """The timing of rows at these times."""
    steps = np.diff(times_s)
    span = float(times_s[-1] - times_s[0])
    if not span > 0 or steps.min() < -TIMING_TOLERANCE_S:
        raise InputError(f"times should rise, got steps of {steps.min():g} to {steps.max():g} s; set --fps")
    even = _is_even(steps)
    typical = float(np.median(steps)) if (steps > 0).all() else span  # where times repeat, no row is missing
    counts = np.where(steps > (0 if even else UNEVEN) * typical, np.maximum(np.rint(steps / typical), 1), 1)
    rate = float(counts.sum()) / span
    deviation = float(np.abs(steps - counts / rate).max())
    rate = usual_rate(rate, RATE_TOLERANCE + deviation / span)
    if not MIN_FPS <= rate <= MAX_FPS:
        raise InputError(f"times should give a rate of {MIN_FPS:g} to {MAX_FPS:g} fps, got {rate:g}; set --fps")
    frames, early = [0], EARLY if even else 2 - UNEVEN
    for time in ((times_s[1:] - times_s[0]) * rate).tolist():
        frames.append(frames[-1] + max(int(time - frames[-1] + early), 1))
    return Timing(rate, np.array(frames))


def usual_rate(fps: float, tolerance: float) -> float:
    """The nearest usual frame rate within a share of a rate, otherwise the rate."""
    nearest = min(USUAL_RATES, key=lambda usual: abs(usual - fps))
    return nearest if abs(nearest / fps - 1) < tolerance else round(fps, 3)


def _seconds(codes: Sequence[re.Match[str]]) -> Timing:
    times = np.array([_number(code[0]) for code in codes])
    step = float(times[-1] - times[0]) / (len(times) - 1)
    unit = next((unit for unit in UNITS if MIN_FPS * step <= unit <= MAX_FPS * step), 1.0)
    return timing_of_times(times / unit)


def _clock(codes: Sequence[re.Match[str]]) -> Timing:
    return timing_of_times(_past_midnight(np.array([_whole(code[2], code[3]) + _number(code[4]) for code in codes])))


def _time_codes(codes: Sequence[re.Match[str]]) -> Timing:
    """The timing at the rate for which the steps are even, otherwise at the lowest that counts so far."""
    seconds = np.array([_whole(code[1], code[2]) + int(code[3]) for code in codes], float)
    last = np.array([_number(code[5]) for code in codes])
    if codes[0][4] == ";":
        return _drop_frame(seconds, last)
    counted = _counted_frames(seconds, codes)
    if counted is not None:
        return counted
    if seconds[-1] == seconds[0]:
        raise InputError("the rate should follow from time codes of more than a second; set --fps")
    lowest = next((rate for rate in CODE_RATES if rate > int(last.max())), None)
    if lowest is None:
        raise InputError(f"time codes should count at most {CODE_RATES[-1]} frames a second, got {last.max():g}")
    times = {rate: _past_midnight(seconds + last / rate) for rate in CODE_RATES if last.max() < rate + 0.5}
    even = (rate for rate, each in times.items() if _is_even(np.diff(each)))
    return timing_of_times(times[next(even, lowest)])


def _drop_frame(seconds: Float[ndarray, " T"], last: Float[ndarray, " T"]) -> Timing:
    """Drop-frame time code: two numbers of 30 (or four of 60) are left out each minute, but for each tenth."""
    base = 30 if last.max() < 30 else 60
    minutes = seconds // 60
    frames = seconds * base + last - base / 15 * (minutes - minutes // 10)
    return timing_of_times((frames - frames[0]) / (base * NTSC))


def _counted_frames(seconds: Float[ndarray, " T"], codes: Sequence[re.Match[str]]) -> Timing | None:
    """The timing where thousandths count frames from 1, at the first usual rate that gives the seconds."""
    thousandths = np.array([int(f"{code[5]}.".replace(",", ".").split(".")[1] or 0) for code in codes])
    if thousandths[0] == 0 or not (np.diff(thousandths) % 1000 == 1).all():
        return None
    frames = thousandths[0] + np.arange(len(codes))
    fitting = (rate for rate in USUAL_RATES if (np.floor(frames / rate + 1e-9) == seconds).all())
    rate = next(fitting, None)
    return None if rate is None else Timing(rate, frames - frames[0])


def _number(text: str) -> float:
    return float(text.replace(",", "."))


def _whole(hours: str | None, minutes: str) -> int:
    return int(hours or 0) * 3600 + int(minutes) * 60


def _past_midnight(times: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
    return np.where(times < times[0] - 43_200, times + 86_400, times)


def _is_even(steps: Float[ndarray, " T"]) -> bool:
    """Whether time steps are even and rise, apart from dropped frames."""
    step = float(np.median(steps))
    counts = np.rint(steps / step) if step > 0 else np.zeros(len(steps))
    return bool((counts >= 1).all() and np.abs(steps - counts * step).max() < TIMING_TOLERANCE_S)
