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

from dataclasses import dataclass
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
from talkingeyes.formats.rotations import from_euler_yxz
from talkingeyes.formats.shape_names import shape_names

ANGLE_SIGNS = np.array([-1.0, 1.0, 1.0])  # of yaw, pitch, roll, from Live Link's to `euler_yxz`
BLENDSHAPE_COUNT = 61
COUNT_COLUMN = "blendshapecount"  # 0 in rows without a face
TIME_COLUMNS = ("timecode", "timestamp", "time")
MAX_RADIAN_SLOPE = 5.0  # a larger slope (angle per look coefficient) means degrees
MIN_LOOK_SD = 0.05  # minimum spread of look coefficients that shows the sign
MIN_CORRELATION = 0.5  # of angles with look coefficients


@dataclass(frozen=True)
class Take:
    """The rows of a file: coefficients and the nine angles (0 if it has none), timing, and rows that have values."""

    coefficients: Float[ndarray, "T 52"]
    angles: Float[ndarray, "T 9"]
    timing: Timing
    seen: Bool[ndarray, " T"]

    @property
    def factors(self) -> Float[ndarray, " 9"]:
        """Factors from the angles of the file to those of `euler_yxz`, in radians."""
        turned = self.angles[:, 3:].reshape(-1, 2, 3) * ANGLE_SIGNS
        eyes = angle_factors(turned, arkit.decoded(self.coefficients).gaze)
        return np.asarray(np.concatenate([np.abs(eyes), eyes, eyes]) * np.tile(ANGLE_SIGNS, 3))


def read_live_link(path: Path, fps: float | None = None) -> Motion:
    """Read a take; frames that are missing or have no values are interpolated, and not valid."""
    take = read_take(path, fps)
    timing = take.timing
    valid = timing.on_frames(take.seen)
    rows = timing.on_frames(np.concatenate([take.coefficients, take.angles * take.factors], axis=1))
    values, angles = np.split(interpolate_gaps(rows, valid), [len(arkit.NAMES)], axis=1)
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
        valid=valid,
    )


def read_take(path: Path, fps: float | None = None) -> Take:
    """The rows of a file, as they are. Raises InputError (one line) if it has none of the coefficients."""
    table = tables.read(path)
    found = dict(zip(shape_names(table.names), table.names, strict=True))
    if found.keys().isdisjoint(arkit.NAMES):
        raise InputError(f"{path}: should have columns EyeLookInLeft, ..., got {', '.join(table.names[:5])}, ...")
    names = (*arkit.NAMES, *arkit.ANGLES)
    values = np.stack(
        [table.column(found[name]) if name in found else np.full(len(table), np.nan) for name in names], axis=1
    )
    coefficients, angles = np.split(values, [len(arkit.NAMES)], axis=1)
    plain = [name.rpartition(".")[2].lower() for name in table.names]
    seen = np.isfinite(coefficients).any(axis=1)
    if COUNT_COLUMN in plain:
        counted = np.nan_to_num(table.column(table.names[plain.index(COUNT_COLUMN)]))
        seen &= (counted > 0) | (counted == 0).all()
    if not seen.any():
        raise InputError(f"{path}: should have rows with values, got none")
    timed = next((table.names[plain.index(name)] for name in TIME_COLUMNS if name in plain), None)
    timing = row_timing(() if timed is None else table.texts(timed), len(table), fps)
    coefficients, angles = _without_gaps(coefficients), _without_gaps(angles)
    if not _follow_looks(angles, coefficients):
        angles[:, 3:] = 0.0
    return Take(coefficients, angles, timing, seen)


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
