"""S sampled motions of one clip, written by `sample` and read by `evaluate`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.containers import parse_json, read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.npz import save_npz
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.recordings import Recording


class SampleSettings(Settings):
    """Number of samples, and the seed from which the seeds of all samples derive."""

    seed: int
    samples: Annotated[int, Field(gt=1)]


@dataclass(frozen=True)
class Samples:
    """S motions of T frames for the same sound: head and eye-in-head rotation vectors."""

    fps: float
    head: Float[ndarray, "S T 3"]
    gaze: Float[ndarray, "S T 2 3"]

    def save(self, path: Path) -> None:
        """Write npz (float32)."""
        save_npz(
            path,
            fps=np.float64(self.fps),
            head=self.head.astype(np.float32),
            gaze=self.gaze.astype(np.float32),
        )

    @classmethod
    def of(cls, fps: float, motions: Sequence[Motion | Recording]) -> Samples:
        """Motions as samples, cut to the shortest."""
        frames = min(map(len, motions))
        head, gaze = (
            np.stack([getattr(motion, part)[:frames].astype(float) for motion in motions]) for part in ("head", "gaze")
        )
        return cls(fps, head, gaze)

    def cropped(self, frames: int) -> Samples:
        """The first `frames` frames of all samples."""
        return Samples(self.fps, self.head[:, :frames], self.gaze[:, :frames])

    @classmethod
    def load(cls, path: Path) -> Samples:
        """Read npz written by `save`. Raises InputError for other files."""
        file = read_npz(path, ("fps", "head", "gaze"), "samples file")
        try:
            return cls(float(file["fps"]), file["head"].astype(np.float64), file["gaze"].astype(np.float64))
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not a readable samples file ({error})") from None


@dataclass(frozen=True)
class FaceSamples:
    """S faces of T frames for the same sound, sampled by a face model for one head.

    `jaw` contains rotation vectors, `expression` weights of the head's shapes, as in a Motion.
    """

    fps: float
    jaw: Float[ndarray, "S T 3"]
    expression: Float[ndarray, "S T C"]
    expression_names: tuple[str, ...]
    head_model: str

    def save(self, path: Path) -> None:
        """Write npz (float32)."""
        save_npz(
            path,
            fps=np.float64(self.fps),
            jaw=self.jaw.astype(np.float32),
            expression=self.expression.astype(np.float32),
            expression_names=np.str_(json.dumps(self.expression_names)),
            head_model=np.str_(self.head_model),
        )

    @classmethod
    def load(cls, path: Path) -> FaceSamples:
        """Read npz written by `save`. Raises InputError for other files."""
        needed = ("fps", "jaw", "expression", "expression_names", "head_model")
        file = read_npz(path, needed, "file of sampled faces")
        try:
            names = tuple(parse_json(str(file["expression_names"])))
            jaw, expression = (file[name].astype(np.float64) for name in ("jaw", "expression"))
            return cls(float(file["fps"]), jaw, expression, names, str(file["head_model"]))
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not a readable file of sampled faces ({error})") from None
