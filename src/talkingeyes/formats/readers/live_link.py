"""CSV of Live Link Face: ARKit coefficients with time codes and nine angles, read by column name.

    LeftEyeYaw = -yaw to the subject's left,  Pitch = down,  Roll = to the subject's right shoulder;  radians

Evidence, from eleven recordings of the app: a look coefficient of 1 corresponds to 34 to 42 degrees if the columns are
read as radians (as degrees it would be 0.65), and the yaw of an eye is negative when it looks to the subject's left.
The sign of pitch is that of public players; that of roll is not known from any recording. Angles are those of R = Ry Rx
Rz. If the angle columns are empty, as in takes without rotations, the look coefficients give the gaze. If the angles
contradict the coefficients in sign or unit, they are corrected, because other programs write other conventions; columns
that do not follow the coefficients at all are no angles.

Audio2Face-3D's client writes the same coefficients without eye angles (`animation_frames.csv`): `timeCode` in seconds,
`blendShapes.EyeBlinkLeft`, ...
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.fitting.gaps import interpolate_gaps
from talkingeyes.formats import arkit
from talkingeyes.formats.readers import tables
from talkingeyes.formats.readers.clock import Timing, row_timing
from talkingeyes.formats.readers.noted import NotedMotion, no_place_note
from talkingeyes.formats.rotations import from_euler_yxz
from talkingeyes.formats.shape_names import EYE_EQUIVALENTS, arkit_shapes, shape_names

ANGLE_SIGNS = np.array([-1.0, 1.0, 1.0])  # of yaw, pitch, roll, from Live Link's to `euler_yxz`
EYE_TURNS, EYE_ROLLS = [3, 4, 6, 7], [5, 8]  # of the nine angles
BLENDSHAPE_COUNT = 61
READ = {*arkit.NAMES, *arkit.ANGLES, *EYE_EQUIVALENTS}
COUNT_COLUMN = "blendshapecount"  # 0 in rows without a face
# Columns of times, `Time (s)` and `timestamp_ms` among them, and others that are no shapes, by their letters.
TIME_COLUMNS = (
    *("timecode", "timestamp", "time", "timestampms", "timestamps", "timestampsec", "timestampseconds"),
    *("timems", "times", "timesec", "timeseconds", "seconds", "t"),
)
OTHER_COLUMNS = {*TIME_COLUMNS, COUNT_COLUMN, "", "frame", "framenumber", "index", "unnamed"}
MAX_RADIAN_SLOPE = 5.0  # a larger slope (angle per look coefficient) means degrees
MIN_LOOK_SD = 0.05  # minimum spread of look coefficients that shows the sign
MAX_COEFFICIENT, MOSTLY = 5.0, 0.99  # coefficients of a column that are mostly larger are percent
MIN_CORRELATION = 0.5  # of angles with look coefficients


@dataclass(frozen=True)
class Take:
    """The rows of a file: coefficients and the nine angles (0 if it has none), timing, and rows that have values."""

    coefficients: Float[ndarray, "T 52"]
    angles: Float[ndarray, "T 9"]
    timing: Timing
    seen: Bool[ndarray, " T"]
    notes: tuple[str, ...] = ()

    @property
    def factors(self) -> Float[ndarray, " 9"]:
        """Factors from the angles of the file to those of `euler_yxz`, in radians."""
        turned = self.angles[:, 3:].reshape(-1, 2, 3) * ANGLE_SIGNS
        eyes = angle_factors(turned, arkit.decoded(self.coefficients).gaze)
        return np.asarray(np.concatenate([np.abs(eyes), eyes, eyes]) * np.tile(ANGLE_SIGNS, 3))


def read_live_link(path: Path, fps: float | None = None) -> NotedMotion:
    """Read a take; frames that are missing or have no values are interpolated, and not valid."""
    take = read_take(path, fps)
    return NotedMotion(motion_of(take), take.notes)


def read_take(path: Path, fps: float | None = None) -> Take:
    """The rows of a file, as they are. Raises InputError (one line) if it has none of the coefficients."""
    table = tables.read(path)
    check_shapes(table.names)
    plain = ["".join(filter(str.isalpha, name.rpartition(".")[2].lower())) for name in table.names]
    others = {name for name, key in zip(table.names, plain, strict=True) if key in OTHER_COLUMNS}
    timed = [table.texts(table.names[plain.index(name)]) for name in TIME_COLUMNS if name in plain]
    timing = row_timing(next((times for times in timed if any(times)), ()), len(table), fps)
    standard = dict(zip(table.names, shape_names(table.names), strict=True))
    shapes = (name for name in table.names if name not in others)
    columns = {name: table.column(name) for name in shapes if standard[name] in READ or table.is_numeric(name)}
    take = take_of(columns, timing)
    if COUNT_COLUMN not in plain:
        return take
    counted = np.nan_to_num(table.column(table.names[plain.index(COUNT_COLUMN)]))
    return replace(take, seen=take.seen & ((counted > 0) | (counted == 0).all()))


def check_shapes(names: Sequence[str]) -> None:
    """Raises InputError (one line) unless a name is one of a coefficient."""
    if {*arkit.NAMES, *EYE_EQUIVALENTS}.isdisjoint(shape_names(names)):
        raise InputError(f"should have shapes of a face (EyeLookInLeft, ...), got {', '.join(names[:5])}, ...")


def take_of(columns: Mapping[str, Float[ndarray, " T"]], timing: Timing) -> Take:
    """The take of columns by their names, NaN where a row has no number."""
    known = arkit_shapes(dict(zip(shape_names(list(columns)), columns.values(), strict=True)))
    nothing = np.full(len(timing.frames), np.nan)
    coefficients, angles = (
        np.stack([known.get(name, nothing) for name in names], axis=1) for names in (arkit.NAMES, arkit.ANGLES)
    )
    seen = np.isfinite(coefficients).any(axis=1)
    if not seen.any():
        raise InputError("should have rows with values, got none")
    coefficients, angles = _without_gaps(coefficients), _without_gaps(angles)
    largest = float(np.quantile(coefficients, MOSTLY, axis=0).max())
    if largest > MAX_COEFFICIENT:
        raise InputError(f"coefficients should be 0 to 1, got {largest:.3g}; divide percent by 100")
    lost = [name for name, standard in zip(columns, shape_names(list(columns)), strict=True) if standard not in READ]
    notes = no_place_note(lost, len(columns))
    if angles[:, EYE_ROLLS].any() and not angles[:, EYE_TURNS].any():
        notes += ("the roll of the eyes has no place here",)
    if angles[:, EYE_TURNS].any() and not _follow_looks(angles, coefficients):
        angles[:, 3:] = 0.0
        notes += ("the angles of the eyes do not follow the look coefficients, which are used alone",)
    return Take(coefficients, angles, timing, seen, notes)


def motion_of(take: Take) -> Motion:
    """The motion of a take."""
    timing = take.timing
    valid = timing.on_frames(take.seen)
    rows = timing.on_frames(np.concatenate([take.coefficients, take.angles * take.factors], axis=1))
    values, angles = np.split(interpolate_gaps(rows, valid), [len(arkit.NAMES)], axis=1)
    decoded = arkit.decoded(values)
    eyes = from_euler_yxz(angles[:, 3:].reshape(-1, 3)).reshape(-1, 2, 3)
    return Motion.of(
        timing.fps,
        from_euler_yxz(angles[:, :3]),
        eyes if angles[:, EYE_TURNS].any() else decoded.gaze,
        lid=decoded.lid,
        jaw=decoded.jaw,
        expression=decoded.expression,
        expression_names=arkit.EXPRESSION,
        valid=valid,
    )


def _without_gaps(values: Float[ndarray, "T C"]) -> Float[ndarray, "T C"]:
    """Columns with missing values interpolated; 0 where a column has none."""
    known = np.isfinite(values)
    for column in np.flatnonzero(~known.all(axis=0)):
        values[:, [column]] = interpolate_gaps(values[:, [column]], known[:, column])
    return values


def _follow_looks(angles: Float[ndarray, "T 9"], coefficients: Float[ndarray, "T 52"]) -> bool:
    """Whether the eye columns are angles: Face_Landmark_Link puts the place of an iris in the picture there."""
    looks = rotation.gaze_to_angles(arkit.decoded(coefficients).gaze)
    turned = angles[:, 3:].reshape(-1, 2, 3)[..., :2]
    varied = [axis for axis in range(2) if looks[..., axis].std() > MIN_LOOK_SD * arkit.LOOK_RANGE_RAD]
    spread = [(looks[..., axis].ravel(), turned[..., axis].ravel()) for axis in varied if turned[..., axis].std() > 0]
    return not varied or any(abs(np.corrcoef(look, turn)[0, 1]) > MIN_CORRELATION for look, turn in spread)


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
