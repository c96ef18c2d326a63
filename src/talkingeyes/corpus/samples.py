"""S sampled motions of one clip: what `sample` writes and `evaluate` reads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.errors import InputError
from talkingeyes.settings import Settings


class SampleSettings(Settings):
    """How many samples, and the seed that the seeds of all samples are made from."""

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
        with path.open("wb") as file:
            np.savez_compressed(
                file,
                allow_pickle=False,
                fps=np.float64(self.fps),
                head=self.head.astype(np.float32),
                gaze=self.gaze.astype(np.float32),
            )

    @classmethod
    def load(cls, path: Path) -> Samples:
        """Read npz written by `save`. Raises InputError if it is not one."""
        try:
            with np.load(path, allow_pickle=False) as file:
                return cls(float(file["fps"]), file["head"].astype(np.float64), file["gaze"].astype(np.float64))
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{path}: not a readable samples file ({error})") from None
