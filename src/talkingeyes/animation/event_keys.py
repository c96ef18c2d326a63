"""Saccades and blinks as editable keys, and the motion that follows from edited keys.

A file of keys is an events file (`core/motion.py: Events`) that also contains, unchanged, the `original` events of the
motion. An edit applies the difference of the two, so that a motion without edits stays bitwise the same:

    gaze'(t) = gaze(t) - S(t; original) + S(t; edited),      S(t) = sum of the displacements of all saccades up to t

in space, for both eyes alike; the head stays and the eyes compensate. A saccade lands at its `end_rad`, whatever was
removed or inserted before it. Lids: a removed blink becomes a straight line between its ends, a new one closes what was
open. A key needs only `onset_s`, and a saccade `end_rad`: the main sequence gives the rest.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import EVENTS_SCHEMA, Blink, Events, Motion, Saccade
from talkingeyes.physiology import blinks, saccades

EDITABLE_KINDS = ("saccades", "blinks")
FIXED_KINDS = ("head_movements", "vergence_movements")  # kept as they are
DIGITS = 6
DEFAULT_BLINK = {"closing_s": 0.085, "hold_s": 0.025, "opening_s": 0.21, "depth": 1.0}

Key = TypeVar("Key", Saccade, Blink)


@dataclass(frozen=True)
class EventKeys:
    """Edited and original keys in order of onset; a saccade of `current` may lack start, duration and skew."""

    current: Events
    original: Events


@dataclass(frozen=True)
class ShiftReason:
    """Why gaze shifts: the onset of the saccade, the state of the conversation and the reason (`shift_reasons.py`)."""

    onset_s: float
    state: str
    reason: str


def save_keys(path: Path, events: Events, fps: float, reasons: Sequence[ShiftReason] = ()) -> None:
    """Write unedited keys, one per line, and the reasons of gaze shifts, which edits do not change."""
    current = [f'"{kind}": {_lines(events, kind)}' for kind in (*EDITABLE_KINDS, *FIXED_KINDS)]
    parts = [f'"schema": "{EVENTS_SCHEMA}"', f'"fps": {fps}', *current, f'"original": {{{", ".join(current)}}}']
    if reasons:
        rows = [{**asdict(each), "onset_s": round(each.onset_s, DIGITS)} for each in reasons]
        parts.append('"reasons": [\n' + ",\n".join(json.dumps(row) for row in rows) + "\n]")
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n")


def _lines(events: Events, kind: str) -> str:
    rows = [
        {name: np.round(value, DIGITS).tolist() for name, value in asdict(key).items()} for key in getattr(events, kind)
    ]
    return "[\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]"


def load_keys(path: Path) -> EventKeys:
    """Read keys. Raises InputError, which names the invalid key."""
    content = read_json(path, "file of keys")
    try:
        if not isinstance(content, dict) or content.get("schema") != EVENTS_SCHEMA:
            schema = content.get("schema") if isinstance(content, dict) else type(content).__name__
            raise InputError(f"{path}: schema should be {EVENTS_SCHEMA}, got {schema}")
        before = content.get("original")
        if not isinstance(before, dict):
            raise InputError(
                f"{path}: should hold the original keys too, as `animate` and `export -f events` write them, got none"
            )
        changed = [name for name in FIXED_KINDS if content.get(name, []) != before.get(name, [])]
        if changed:
            raise InputError(
                f"{path}: {' and '.join(EDITABLE_KINDS)} can be edited, got other {changed[0]} than the original ones"
            )
        return EventKeys(_events(path, content), _events(path, before))
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a readable file of keys ({error!r})") from None


def load_original(path: Path) -> Events:
    """The original events of a motion from its file of keys, without later edits."""
    found = Events.load(path)  # raises InputError if there are none
    return load_keys(path).original if "original" in read_json(path, "file of keys") else found


def apply_key_edits(motion: Motion, keys: EventKeys) -> Motion:
    """Apply the edits of the keys to the motion that they belong to."""
    times = np.arange(len(motion)) / motion.fps
    space = rotation.gaze_in_space(motion.head, motion.gaze)
    shift = _shift(keys, rotation.cyclopean_gaze(space), times)
    moved = np.flatnonzero(shift.any(axis=1))
    gaze = motion.gaze.copy()
    gaze[moved] = rotation.eye_in_head(motion.head[moved], space[moved] + shift[moved, None])
    return replace(motion, gaze=gaze, lid=edit_lids(motion.lid, keys, times))


def _shift(keys: EventKeys, gaze_rad: Float[ndarray, "T 2"], times: Float[ndarray, " T"]) -> Float[ndarray, "T 2"]:
    """S(t; edited) - S(t; original), accumulated saccade by saccade."""
    gone = [each for each in keys.original.saccades if each not in keys.current.saccades]
    kept = set(keys.original.saccades)
    shift = np.zeros((len(times), 2))
    for each in gone:
        shift += _without(each, gaze_rad, times)
    for each in keys.current.saccades:
        before = np.array([np.interp(each.onset_s, times, column) for column in shift.T])
        if each in kept:  # it keeps its landing, from a new start
            if before.any():
                shift += _step(each, -before, times)
            continue
        start = np.array([np.interp(each.onset_s, times, column) for column in (gaze_rad + shift).T])
        step = np.subtract(each.end_rad, start)
        shift += _step(_fill_main_sequence(each, step), step, times)
    return np.where(np.abs(shift) < 1e-12, 0.0, shift)


def _without(saccade: Saccade, gaze_rad: Float[ndarray, "T 2"], times: Float[ndarray, " T"]) -> Float[ndarray, "T 2"]:
    """The shift that removes a saccade: a straight line in its frames, whose profile may not be the main sequence."""
    step = np.subtract(saccade.end_rad, saccade.start_rad)
    ends = np.searchsorted(times, [saccade.onset_s, saccade.onset_s + saccade.duration_s])
    first, last = max(int(ends[0]) - 1, 0), min(int(ends[1]), len(times) - 1)
    shift = np.zeros((len(times), 2))
    shift[last:] = -step
    share = (np.arange(first, last) - first)[:, None] / max(last - first, 1)
    line = gaze_rad[first] + share * (gaze_rad[last] - step - gaze_rad[first])
    shift[first:last] = line - gaze_rad[first:last]
    return shift


def _step(saccade: Saccade, step: Float[ndarray, " 2"], times: Float[ndarray, " T"]) -> Float[ndarray, "T 2"]:
    done = saccades.completed_fraction((times - saccade.onset_s) / saccade.duration_s, saccade.skew)
    return np.asarray(done[:, None] * step)


def _fill_main_sequence(saccade: Saccade, step: Float[ndarray, " 2"]) -> Saccade:
    """Fill in duration and skew of the main sequence where the key has 0."""
    amplitude = float(np.linalg.norm(step))
    return replace(
        saccade,
        duration_s=saccade.duration_s or float(saccades.duration_s(amplitude)),
        skew=saccade.skew or float(saccades.skew(amplitude)),
    )


def edit_lids(lid: Float[ndarray, "T 2"], keys: EventKeys, times: Float[ndarray, " T"]) -> Float[ndarray, "T 2"]:
    gone = [each for each in keys.original.blinks if each not in keys.current.blinks]
    new = [each for each in keys.current.blinks if each not in keys.original.blinks]
    found = lid.copy()
    for each in gone:
        first, stop = np.searchsorted(times, [each.onset_s, blinks.end_s(each)])
        ends = [max(first - 1, 0), min(stop, len(times) - 1)]
        for eye in range(2):
            found[first:stop, eye] = np.interp(np.arange(first, stop), ends, lid[ends, eye])
    if new:
        shut = blinks.blink_closure(new, times)[:, None]
        found = np.where(shut > 0, found + (1.0 - found) * shut, found)
    return found


def _events(path: Path, content: Mapping[str, Any]) -> Events:
    found = {kind: [_key(path, kind, row) for row in content[kind]] for kind in EDITABLE_KINDS}
    for kind, keys in found.items():
        keys.sort(key=lambda each: float(each.onset_s))
        for first, second in itertools.pairwise(keys):
            if second.onset_s == first.onset_s:
                raise InputError(f"{path}: {kind} should start one after another, got two at {first.onset_s:g} s")
    return Events(saccades=tuple(found["saccades"]), blinks=tuple(found["blinks"]))


def _key(path: Path, kind: str, row: Mapping[str, Any]) -> Any:
    known = {
        "saccades": ("onset_s", "end_rad", "start_rad", "duration_s", "skew"),
        "blinks": ("onset_s", *DEFAULT_BLINK),
    }
    strange = [name for name in row if name not in known[kind]]
    if strange or "onset_s" not in row or (kind == "saccades" and "end_rad" not in row):
        needed = "onset_s and end_rad" if kind == "saccades" else "onset_s"
        raise InputError(f"{path}: a key of {kind} should have {needed}, perhaps {known[kind][-1]}, got {dict(row)}")
    numbers = [float(value) for name in row for value in np.ravel(row[name])]
    times = [float(row[name]) for name in row if name.endswith("_s") or name == "depth"]
    if not np.isfinite(numbers).all() or min(times) < 0:
        raise InputError(f"{path}: a key of {kind} should hold finite numbers, times from 0 s, got {dict(row)}")
    if kind == "blinks":
        return Blink(
            **{"onset_s": float(row["onset_s"]), **{k: float(row.get(k, v)) for k, v in DEFAULT_BLINK.items()}}
        )
    start, end = (tuple(float(value) for value in row.get(name, (0.0, 0.0))) for name in ("start_rad", "end_rad"))
    if len(start) != 2 or len(end) != 2:
        raise InputError(f"{path}: start_rad and end_rad should be yaw and pitch, got {dict(row)}")
    return Saccade(
        onset_s=float(row["onset_s"]),
        duration_s=float(row.get("duration_s", 0.0)),
        start_rad=(start[0], start[1]),
        end_rad=(end[0], end[1]),
        skew=float(row.get("skew", 0.0)),
    )
