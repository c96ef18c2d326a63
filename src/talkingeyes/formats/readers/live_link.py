"""CSV of Live Link Face: ARKit coefficients with time codes and nine angles, read by column name.

    LeftEyeYaw = -yaw to the subject's left,  Pitch = down,  Roll = to the subject's right shoulder;  radians

Evidence, from eleven recordings of the app: a look coefficient of 1 corresponds to 34 to 42 degrees if the columns are
read as radians (as degrees it would be 0.65), and the yaw of an eye is negative when it looks to the subject's left.
The sign of pitch is that of public players; that of roll is not known from any recording. Angles are those of R = Ry Rx
Rz. If the angle columns are empty, as in takes without rotations, the look coefficients give the gaze. If the angles
contradict the coefficients in sign or unit, they are corrected, because other programs write other conventions.

Audio2Face-3D's client writes the same coefficients without eye angles (`animation_frames.csv`): `timeCode` in seconds,
`blendShapes.EyeBlinkLeft`, ...
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.readers import tables
from talkingeyes.formats.rotations import from_euler_yxz
from talkingeyes.formats.shape_names import shape_names

ANGLE_SIGNS = np.array([-1.0, 1.0, 1.0])  # of yaw, pitch, roll, from Live Link's to `euler_yxz`
BLENDSHAPE_COUNT = 61
TIMECODE = re.compile(r"(\d+):(\d+):(\d+):(\d+(?:\.\d+)?)")
SECONDS = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")
TIMECODE_RATES = (24, 25, 30, 48, 50, 60, 90, 100, 120, 240)  # frame rates of time codes
TIMING_TOLERANCE_S = 0.003  # maximum deviation from even time steps
MAX_RADIAN_SLOPE = 5.0  # a larger slope (angle per look coefficient) means degrees
MIN_LOOK_SD = 0.05  # minimum spread of look coefficients that shows the sign


@dataclass(frozen=True)
class TakeTiming:
    """Frame rate of a take, and the time of each of its rows."""

    fps: float
    times_s: Float[ndarray, " T"]


@dataclass(frozen=True)
class Take:
    """The rows of a file: coefficients, the nine angles (0 if it has none), timing."""

    coefficients: Float[ndarray, "T 52"]
    angles: Float[ndarray, "T 9"]
    timing: TakeTiming

    @property
    def frames(self) -> Int[ndarray, " T"]:
        """The frame of each row, on even steps; dropped frames have no row."""
        return np.rint(self.timing.times_s * self.timing.fps).astype(int)

    @property
    def factors(self) -> Float[ndarray, " 9"]:
        """Factors from the angles of the file to those of `euler_yxz`, in radians."""
        turned = self.angles[:, 3:].reshape(-1, 2, 3) * ANGLE_SIGNS
        eyes = angle_factors(turned, arkit.decoded(self.coefficients).gaze)
        return np.asarray(np.concatenate([np.abs(eyes), eyes, eyes]) * np.tile(ANGLE_SIGNS, 3))


def read_live_link(path: Path, fps: float | None = None) -> Motion:
    """Read a take. Raises InputError if it is invalid, or if its rate does not follow from its time codes."""
    take = read_take(path, fps)
    timing = take.timing
    grid_s = np.arange(int(timing.times_s[-1] * timing.fps + 1.5)) / timing.fps
    table = np.concatenate([take.coefficients, take.angles * take.factors], axis=1)
    values, angles = np.split(_fill_dropped(grid_s, timing.times_s, table), [len(arkit.NAMES)], axis=1)
    decoded = arkit.decoded(values)
    gaze = from_euler_yxz(angles[:, 3:].reshape(-1, 3)).reshape(-1, 2, 3) if angles[:, 3:].any() else decoded.gaze
    return Motion.of(
        timing.fps,
        from_euler_yxz(angles[:, :3]),
        gaze,
        lid=decoded.lid,
        jaw=decoded.jaw,
        expression=decoded.expression,
        expression_names=arkit.EXPRESSION,
    )


def read_take(path: Path, fps: float | None = None) -> Take:
    """The rows of a file, as they are. Raises InputError (one line) if it has none of the coefficients."""
    table = tables.read(path)
    found = dict(zip(shape_names(table.names), table.names, strict=True))
    if found.keys().isdisjoint(arkit.NAMES):
        raise InputError(f"{path}: should have columns EyeLookInLeft, ..., got {', '.join(table.names[:5])}, ...")
    values = np.stack(
        [
            table.column(found[name]) if name in found else np.zeros(len(table))
            for name in (*arkit.NAMES, *arkit.ANGLES)
        ],
        axis=1,
    )
    timed = next((name for name in table.names if name.lower().rpartition(".")[2] == "timecode"), None)
    codes = () if timed is None else table.texts(timed)
    coefficients, angles = np.split(values, [len(arkit.NAMES)], axis=1)
    return Take(coefficients, angles, _clock(path, codes, len(table), fps))


def angle_factors(turned: Float[ndarray, "T 2 3"], looks: Float[ndarray, "T 2 3"]) -> Float[ndarray, " 3"]:
    """Factors from the angles of a file (in `euler_yxz` order) to radians of the sign that the look coefficients say.

    Yaw and pitch can have either sign; a file in degrees is so in all three angles. 1 where nothing says otherwise.
    """
    stated = rotation.gaze_to_angles(looks) / arkit.LOOK_RANGE_RAD * [1.0, -1.0]  # yaw to the left, pitch down
    signs, unit = np.ones(3), 1.0
    for axis in range(2):
        if turned.any() and stated[..., axis].std() > MIN_LOOK_SD:
            slope = float(np.polyfit(stated[..., axis].ravel(), turned[..., axis].ravel(), 1)[0])
            signs[axis] = -1.0 if slope < 0 else 1.0
            unit = np.pi / 180 if abs(slope) > MAX_RADIAN_SLOPE else unit
    return signs * unit


def _clock(path: Path, codes: tuple[str, ...], rows: int, fps: float | None) -> TakeTiming:
    """Timing by time codes, at the rate for which steps are even; without time codes, by `fps`."""
    if rows > 1 and codes and all(SECONDS.fullmatch(code.strip()) for code in codes):
        return _seconds(path, np.array(codes, np.float64), fps)
    read = [TIMECODE.fullmatch(code.strip()) for code in codes]
    if rows < 2 or (read and not all(read)):
        raise InputError(f"{path}: should hold two or more frames with time codes like 18:48:59:39.473")
    if not read:
        if fps is None:
            raise InputError(f"{path}: should contain time codes, got none; set --fps")
        return TakeTiming(fps, np.arange(rows) / fps)
    parts = np.array([[float(part) for part in match.groups()] for match in read if match])
    seconds = parts[:, :3] @ [3600.0, 60.0, 1.0]
    for rate in TIMECODE_RATES:
        if parts[:, 3].max() >= rate + 0.5 or (fps is None and seconds[-1] == seconds[0]):
            continue
        times = seconds + parts[:, 3] / rate
        times = np.where(times < times[0], times + 86_400, times) - times[0]
        steps = np.diff(times)
        if (steps > 0).all() and _is_even(steps):
            step = float(np.median(steps)) if fps is None else 1 / fps
            within = np.abs(np.round(steps / step) * step - steps).max() < TIMING_TOLERANCE_S
            if within:
                counted = np.round(steps / step).sum()
                return TakeTiming(_round_rate(counted / float(times[-1])) if fps is None else fps, times)
    raise InputError(f"{path}: the rate should follow from its time codes (is the take too short?); set --fps")


def _seconds(path: Path, seconds: Float[ndarray, " T"], fps: float | None) -> TakeTiming:
    """Timing by seconds, as Audio2Face's client writes them."""
    times, steps = seconds - seconds[0], np.diff(seconds)
    if not ((steps > 0).all() and _is_even(steps)):
        raise InputError(f"{path}: time codes should rise in even steps, got steps of {steps.min():g} s")
    return TakeTiming(_round_rate(1 / float(np.median(steps))) if fps is None else fps, times)


def _is_even(steps: Float[ndarray, " T"]) -> bool:
    """Whether time steps are even, apart from dropped frames."""
    step = float(np.median(steps))
    return bool(np.abs(steps / step - np.round(steps / step)).max() * step < TIMING_TOLERANCE_S)


def _round_rate(fps: float) -> float:
    """The nearest standard rate if it is close enough, otherwise the rate itself."""
    usual = [*map(float, TIMECODE_RATES), *(rate * 1000 / 1001 for rate in (24, 30, 60, 120))]
    nearest = min(usual, key=lambda rate: abs(rate - fps))
    return nearest if abs(nearest / fps - 1) < 2e-4 else fps


def _fill_dropped(
    grid_s: Float[ndarray, " G"], times_s: Float[ndarray, " T"], values: Float[ndarray, "T C"]
) -> ndarray:
    """Values on an even time grid, with dropped frames interpolated."""
    if len(grid_s) == len(times_s):
        return values
    return np.stack([np.interp(grid_s, times_s, column) for column in values.T], axis=1)
