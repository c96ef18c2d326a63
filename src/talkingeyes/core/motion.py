"""The Motion record: the motion of head, eyes, lids and face as arrays, and its events.

Frame t is the state at time t / fps (point-sampled). Files are npz without pickles; units, axes, eye order, frame rate
and head model are stored in every file (docs/conventions.md). Events are JSON beside the npz.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core.containers import parse_json, read_json, read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.core.npz import save_npz

CONVENTIONS = {
    "schema": "talkingeyes.motion/1",
    "axes": "right-handed, y up, +z out of the face, +x to the subject's left",
    "units": "radians, metres",
    "rotations": "rotation vectors",
    "eye_order": "left,right (the subject's)",
}
MAX_VALUE = 1e6  # of radians, metres and weights: files hold float32
ARRAY_FIELDS = ("head", "translation", "gaze", "lid", "jaw", "expression", "valid")


@dataclass(frozen=True)
class Motion:
    """Motion of T frames at `fps`.

    `head` combines root and neck, `gaze` is eye-in-head, `lid` the third parameter of the Eyelid model (0 as gaze alone
    opens the eye, 1 shut, negative wider), `expression` the weights of the head model's shapes without gaze, blink and
    jaw.
    """

    fps: float
    head: Float[ndarray, "T 3"]
    translation: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]
    lid: Float[ndarray, "T 2"]
    jaw: Float[ndarray, "T 3"]
    expression: Float[ndarray, "T C"]
    valid: Bool[ndarray, " T"]
    expression_names: tuple[str, ...] = ()
    head_model: str = "anny"

    def __post_init__(self) -> None:
        frames = len(self.head) if self.head.ndim else 0
        shapes = {
            "head": (frames, 3),
            "translation": (frames, 3),
            "gaze": (frames, 2, 3),
            "lid": (frames, 2),
            "jaw": (frames, 3),
            "expression": (frames, len(self.expression_names)),
            "valid": (frames,),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape:
                raise InputError(f"motion: {name} should have shape {shape}, got {array.shape}")
            if array.dtype.kind not in ("b" if name == "valid" else "fiub"):
                kind = "true or false" if name == "valid" else "numbers"
                raise InputError(f"motion: {name} should hold {kind}, got {array.dtype}")
            if not np.isfinite(array).all():
                raise InputError(
                    f"motion: {name} should be finite, got NaN or infinite values; mark such frames as not valid"
                )
            if name != "valid" and (largest := np.abs(array).max(initial=0)) > MAX_VALUE:
                raise InputError(f"motion: {name} should be at most {MAX_VALUE:g}, got {largest:.3g}")
        if not self.fps > 0:
            raise InputError(f"motion: fps should be above 0, got {self.fps}")

    def __len__(self) -> int:
        return len(self.head)

    @property
    def seconds(self) -> float:
        return len(self) / self.fps

    @property
    def parts_at_rest(self) -> tuple[str, ...]:
        """The parts without any value but 0, as of a file that lacks them: of head, gaze, lids, face."""
        parts = {"head": (self.head,), "gaze": (self.gaze,), "lids": (self.lid,), "face": (self.jaw, self.expression)}
        return tuple(name for name, arrays in parts.items() if not any(array.any() for array in arrays))

    @classmethod
    def of(
        cls,
        fps: float,
        head: Float[ndarray, "T 3"],
        gaze: Float[ndarray, "T 2 3"],
        **others: Any,
    ) -> Motion:
        """A motion of head and gaze; other fields are neutral unless given."""
        frames = len(head)
        neutral: dict[str, Any] = {
            "translation": np.zeros((frames, 3)),
            "lid": np.zeros((frames, 2)),
            "jaw": np.zeros((frames, 3)),
            "expression": np.zeros((frames, len(others.get("expression_names", ())))),
            "valid": np.ones(frames, bool),
        }
        return cls(fps=fps, head=head, gaze=gaze, **{**neutral, **others})

    def cut(self, start: int, stop: int) -> Motion:
        """Frames from `start` up to `stop`."""
        return replace(self, **{name: getattr(self, name)[start:stop] for name in ARRAY_FIELDS})

    def save(self, path: Path) -> None:
        """Write as npz (float32), including fps, units, axes, rotation form, eye order and head model."""
        arrays = {name: getattr(self, name) for name in ARRAY_FIELDS}
        arrays = {name: a if a.dtype == bool else a.astype(np.float32) for name, a in arrays.items()}
        texts = {**CONVENTIONS, "head_model": self.head_model, "expression_names": json.dumps(self.expression_names)}
        save_npz(
            path,
            fps=np.float64(self.fps),
            **arrays,
            **{k: np.str_(v) for k, v in texts.items()},
        )

    @classmethod
    def load(cls, path: Path) -> Motion:
        """Read a motion npz. Raises InputError if it is missing, not a motion file, or of another schema."""
        needed = (*ARRAY_FIELDS, "fps", "expression_names", "head_model")
        content = read_npz(path, {"schema", *needed}, "motion npz")
        schema = str(content.get("schema", "none"))
        if schema != CONVENTIONS["schema"]:
            raise InputError(f"{path}: schema should be {CONVENTIONS['schema']}, got {schema}")
        missing = [name for name in needed if name not in content]
        if missing:
            raise InputError(f"{path}: missing {', '.join(missing)}")
        try:
            fps, names = float(content["fps"]), tuple(parse_json(str(content["expression_names"])))
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}: fps should be a number and expression_names a list ({error})") from None
        arrays = {name: content[name] for name in ARRAY_FIELDS}
        motion = cls(fps=fps, expression_names=names, head_model=str(content["head_model"]), **arrays)
        if not len(motion):
            raise InputError(f"{path}: should have frames, got none")
        return motion


@dataclass(frozen=True)
class Saccade:
    """A rapid shift of gaze in space, both eyes. Angles are (yaw, pitch) in radians, times in seconds."""

    onset_s: float
    duration_s: float
    start_rad: tuple[float, float]
    end_rad: tuple[float, float]
    skew: float


@dataclass(frozen=True)
class HeadMovement:
    """A head movement that adds the rotation vector `delta_rad` over `duration_s` (minimum jerk)."""

    onset_s: float
    duration_s: float
    delta_rad: tuple[float, float, float]


@dataclass(frozen=True)
class Blink:
    """A lid closure: closing, hold and opening times in seconds; `depth` 1 is fully shut."""

    onset_s: float
    closing_s: float
    hold_s: float
    opening_s: float
    depth: float


@dataclass(frozen=True)
class VergenceMovement:
    """A change of vergence from `onset_s` on, to a target at `distance_m` (slow: physiology.vergence)."""

    onset_s: float
    distance_m: float


@dataclass(frozen=True)
class Events:
    """The events of a motion, each list in order of onset."""

    saccades: tuple[Saccade, ...] = ()
    head_movements: tuple[HeadMovement, ...] = ()
    blinks: tuple[Blink, ...] = ()
    vergence_movements: tuple[VergenceMovement, ...] = ()

    def save(self, path: Path) -> None:
        """Write as JSON, including the schema."""
        path.write_text(json.dumps({"schema": EVENTS_SCHEMA, **asdict(self)}, indent=1))

    @classmethod
    def load(cls, path: Path) -> Events:
        """Read events JSON; absent kinds are empty. Raises InputError if it is not an events file."""
        content = read_json(path, "events file")
        try:
            if content.get("schema") != EVENTS_SCHEMA:
                raise InputError(f"{path}: schema should be {EVENTS_SCHEMA}, got {content.get('schema')}")
            rows = {kind: content.get(kind, ()) for kind in EVENT_TYPES}
            return cls(**{kind: tuple(_event(EVENT_TYPES[kind], row) for row in rows[kind]) for kind in rows})
        except InputError:
            raise
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{path}: not a readable events file ({error!r})") from None


EVENTS_SCHEMA = "talkingeyes.events/2"
EVENT_TYPES = {
    "saccades": Saccade,
    "head_movements": HeadMovement,
    "blinks": Blink,
    "vergence_movements": VergenceMovement,
}


def _event(kind: type, row: dict[str, Any]) -> Any:
    values = {field.name: row[field.name] for field in fields(kind)}
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})
