"""Target tracks: what gaze goes to and when, read from JSON or CSV (docs/control.md).

Positions are in metres from the point between the eyes of the head at rest: +x to the subject's left, y up, +z ahead.
In frame `world` they are fixed in space, in frame `head` they move with the head. The objects `camera` and `listener`
are predefined, straight ahead; a track may move them and define others. A fourth coordinate makes a position
homogeneous: (x, y, z, 0) is the direction (x, y, z) at infinity, where the lines of sight are parallel.
"""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.containers import parse_json, read_text
from talkingeyes.core.errors import InputError

SCHEMA = "talkingeyes.targets/1"
COLUMNS = ("start_s", "end_s", "name", "x_m", "y_m", "z_m")
W_COLUMN = "w"  # may follow; 1 where it is empty
DEFAULT_DISTANCE_M = 1.0
MIN_DISTANCE_M, MAX_DISTANCE_M = 0.15, 1e6
# Largest yaw and pitch of a target: for head and eyes together, and for the eyes alone.
MAX_ECCENTRICITY_DEG = {"world": (75.0, 45.0), "head": (20.0, 12.0)}
MIN_TARGET_S = 0.25


@dataclass(frozen=True)
class ObjectTrack:
    """Homogeneous positions of an object at ascending times, linearly interpolated; a single one: a fixed object.

    `positions`: (x, y, z, 1) in metres, or a unit direction (x, y, z, 0) at infinity.
    """

    times_s: tuple[float, ...]
    positions: tuple[tuple[float, float, float, float], ...]

    @classmethod
    def fixed(cls, x: float, y: float, z: float, w: float = 1.0) -> ObjectTrack:
        """A fixed object."""
        return cls((0.0,), (normalised_position((x, y, z, w)),))

    def at(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 4"]:
        """Homogeneous position at each time."""
        return np.stack([np.interp(times_s, self.times_s, axis) for axis in zip(*self.positions, strict=True)], -1)


def normalised_position(position: Sequence[float]) -> tuple[float, float, float, float]:
    """(x, y, z, 1) of a point in three or four coordinates, or a unit direction (x, y, z, 0).

    Raises ValueError for w below 0, or a direction of length 0.
    """
    x, y, z, w = (*position, 1.0)[:4]
    scale = w or math.hypot(x, y, z)
    if w < 0 or not scale:
        raise ValueError(f"a position should have w of 0 or more, and a direction for w = 0, got {list(position)}")
    return x / scale, y / scale, z / scale, 1.0 if w else 0.0


STRAIGHT_AHEAD = ObjectTrack.fixed(0.0, 0.0, DEFAULT_DISTANCE_M)
CAMERA, LISTENER = "camera", "listener"


@dataclass(frozen=True)
class Target:
    """Gaze is at the object `name` from `start_s` to `end_s`."""

    start_s: float
    end_s: float
    name: str


@dataclass(frozen=True)
class TargetTrack:
    """Targets in order of time, the objects that they name, and the coordinate frame of the objects."""

    targets: tuple[Target, ...] = ()
    objects: Mapping[str, ObjectTrack] = field(default_factory=dict)
    frame: Literal["world", "head"] = "world"

    def object_track(self, name: str) -> ObjectTrack:
        """The track of a named object; camera and listener are straight ahead by default."""
        return self.objects.get(name, STRAIGHT_AHEAD)


def load_targets(path: Path | str) -> TargetTrack:
    """Read a track from CSV (by the suffix) or JSON. Raises InputError (one line) for an invalid file."""
    path = Path(path)
    text = read_text(path, "track of targets")
    try:
        return _of_csv(text) if path.suffix.lower() == ".csv" else _of_json(parse_json(text))
    except (ValueError, csv.Error) as error:  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        raise InputError(f"{path}: {error}") from None


def constant_target(name: str) -> TargetTrack:
    """A track with one target, camera or listener, for the whole animation."""
    if name not in (CAMERA, LISTENER):
        raise InputError(f"target: should be {CAMERA}, {LISTENER} or a file of targets (.json, .csv), got {name}")
    return TargetTrack((Target(0.0, math.inf, name),))


def _of_json(content: Any) -> TargetTrack:
    schema = content.get("schema") if isinstance(content, dict) else type(content).__name__
    if schema != SCHEMA:
        raise ValueError(f"schema should be {SCHEMA}, got {schema}")
    if strange := set(content) - {"schema", "frame", "objects", "targets"}:
        raise ValueError(f"should hold schema, frame, objects and targets, got {min(strange)}")
    frame = content.get("frame", "world")
    if frame not in ("world", "head"):
        raise ValueError(f"frame should be world or head, got {frame}")
    objects, rows = content.get("objects", {}), content.get("targets")
    if not isinstance(objects, dict) or not isinstance(rows, list):
        raise ValueError("objects should be names with positions, targets a list")
    tracks = {name: _parse_track(name, value) for name, value in objects.items()}
    targets = []
    for number, row in enumerate(rows, 1):
        if not isinstance(row, dict) or not {"start_s", "at"} <= set(row) <= {"start_s", "end_s", "at"}:
            raise ValueError(f"target {number} should have start_s, at and perhaps end_s, got {row}")
        name = row["at"]
        if isinstance(name, list):
            name, tracks[f"target {number}"] = f"target {number}", _parse_track(f"target {number}", name)
        targets.append((_number(row["start_s"]), _number(row.get("end_s")), name))
    return _checked(targets, tracks, frame)


def _of_csv(text: str) -> TargetTrack:
    reader = csv.DictReader(text.splitlines())
    given = set(reader.fieldnames or ()) - {W_COLUMN}
    if given not in (set(COLUMNS), set(COLUMNS[:3]), set(COLUMNS) - {"name"}):
        raise ValueError(f"columns should be {', '.join(COLUMNS)}, got {', '.join(reader.fieldnames or ('none',))}")
    tracks: dict[str, ObjectTrack] = {}
    targets = []
    for number, row in enumerate(reader, 1):
        if None in row or None in row.values():
            raise ValueError(f"row {number} should have {len(reader.fieldnames or ())} columns")
        name = row.get("name") or f"target {number}"
        position = [row.get(axis) or "" for axis in COLUMNS[3:]]
        if any(position):
            tracks[name] = _parse_track(name, [*map(_number, position), _number(row.get(W_COLUMN) or "1")])
        if row["start_s"]:
            targets.append((_number(row["start_s"]), _number(row["end_s"] or None), name))
    return _checked(targets, tracks, "world")


def _parse_track(name: str, value: Any) -> ObjectTrack:
    """Parse a position, or times_s and positions_m of a moving object."""
    moving = isinstance(value, dict)
    if moving and set(value) != {"times_s", "positions_m"}:
        raise ValueError(f"{name} should be [x, y, z] or have times_s and positions_m, got {sorted(value)}")
    times = [_number(each) for each in value["times_s"]] if moving else [0.0]
    rows = value["positions_m"] if moving else [value]
    if not isinstance(rows, list) or any(not isinstance(row, list) or len(row) not in (3, 4) for row in rows):
        raise ValueError(f"{name} should have positions [x, y, z] in metres or [x, y, z, w], got {rows}")
    positions = tuple(normalised_position([_number(each) for each in row]) for row in rows)
    if not times or len(times) != len(positions) or any(b <= a for a, b in itertools.pairwise(times)):
        raise ValueError(f"{name} should have ascending times_s, one a position, got {times}")
    return ObjectTrack(tuple(times), positions)


def check_reach(name: str, position: Sequence[float], frame: str) -> None:
    """Raises ValueError for a position that head and eyes (`world`), or the eyes alone (`head`), do not reach.

    `position` has three or four coordinates, as `normalised_position` takes them.
    """
    x, y, z, w = normalised_position(position)
    distance = math.hypot(x, y, z)
    if w and not MIN_DISTANCE_M <= distance <= MAX_DISTANCE_M:
        raise ValueError(f"{name} should be {MIN_DISTANCE_M} m to {MAX_DISTANCE_M:g} m away, got {distance:g} m")
    yaw, pitch = math.degrees(math.atan2(x, z)), math.degrees(math.asin(y / distance))
    aside, above = MAX_ECCENTRICITY_DEG[frame]
    if abs(yaw) > aside or abs(pitch) > above:
        raise ValueError(
            f"{name} should be within {aside:g} degrees to the side and {above:g} up or down of straight ahead, "
            f"got {yaw:.0f} and {pitch:.0f}"
        )


def _number(value: Any) -> float:
    """A finite number; None is infinity: until the end of the sound."""
    if value is None:
        return math.inf
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"should be a number, got {value}")
    try:
        number = float(value)
    except ValueError:
        raise ValueError(f"should be a number, got {value!r}") from None
    if not math.isfinite(number):
        raise ValueError(f"should be a finite number, got {value}")
    return number


def _checked(
    rows: Sequence[tuple[float, float, Any]], tracks: Mapping[str, ObjectTrack], frame: Literal["world", "head"]
) -> TargetTrack:
    """Validate rows (start, end, name); an infinite end becomes the start of the next target."""
    if not rows and not tracks:
        raise ValueError("should hold at least one target or object")
    for name, object_track in tracks.items():
        for position in object_track.positions:
            check_reach(name, position, frame)
    known = [CAMERA, LISTENER, *tracks]
    targets: list[Target] = []
    for number, (start, end, name) in enumerate(rows, 1):
        if not isinstance(name, str) or name not in known:
            raise ValueError(f"target {number} should be one of {', '.join(dict.fromkeys(known))}, got {name}")
        following = rows[number][0] if number < len(rows) else math.inf
        if start < 0 or min(end, following) < start + MIN_TARGET_S or (end > following and end < math.inf):
            span = f"{start:g} to {end:g} s" if end < math.inf else f"{start:g} s"
            raise ValueError(
                f"target {number} should start at 0 s or later, end after it and before the next, got {span}"
            )
        targets.append(Target(start, min(end, following), name))
    return TargetTrack(tuple(targets), dict(tracks), frame)
